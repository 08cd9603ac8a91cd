"""Files of a new version."""

from __future__ import annotations

import os
import secrets
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from fastsplat.service.capture.photos.scene_photos import share_photos
from fastsplat.service.scene.artefact.scene import Scene
from fastsplat.service.scene.artefact.scene_files import write_scene
from fastsplat.service.scene.formats.ply import write_ply
from fastsplat.service.store.blobs.blobs import Blobs, remove


def new_version_name() -> str:
    """Random name for a version."""
    return f"e{secrets.token_hex(8)}"


def write_version(
    scene: Scene,
    blobs: Blobs,
    scene_id: str,
    version: str,
    parent: Path,
    same_gaussians: bool,
    add_files: Callable[[Path], None] = lambda folder: None,
) -> None:
    """Writes a version's folder atomically; a leftover scratch folder counts as an upload.

    Args:
        parent: lends its photos, and its PLY file if `same_gaussians`.
        add_files: adds further files before the folder is published.
    """
    scratch = blobs.upload(version)
    try:
        scratch.mkdir(parents=True)
        write_scene(scene, scratch / "artefact")
        if same_gaussians:
            with suppress(OSError):  # not every file system has hard links
                os.link(parent / "scene.ply", scratch / "scene.ply")
        if not (scratch / "scene.ply").exists():
            write_ply(scene.gaussians, scratch / "scene.ply")
        share_photos(parent, scratch)
        add_files(scratch)
        blobs.publish(scratch, scene_id, version)
    finally:
        remove(scratch)
