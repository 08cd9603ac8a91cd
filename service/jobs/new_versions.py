"""Rows of new versions, assembled in one place so that none is incomplete."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from fastsplat.service.query.objects.labeled_objects import label_gaussians, objects_of
from fastsplat.service.query.objects.names.look_alikes import Sizes, sizes_in_meters
from fastsplat.service.query.objects.names.names_from_scenes import described
from fastsplat.service.scene.artefact.alignment import alignment_to_json
from fastsplat.service.scene.artefact.scaling import scaling_to_json
from fastsplat.service.scene.artefact.scene import Objects, Scene, SceneFacts
from fastsplat.service.scene.objects.objects import object_count
from fastsplat.service.settings import CallSettings
from fastsplat.service.store.repositories.name_repository import names_between
from fastsplat.service.store.repositories.version_repository import NewVersion


def new_version(
    scene_id: str,
    version: str,
    parent: str,
    edits: Sequence[Mapping[str, Any]],
    before: Objects | None,
    scene: Scene,
    content: Mapping[str, Any],
    limits: CallSettings,
    *,
    sizes: Sizes | None = None,
    author: str = "",
    request: tuple[str, str] = ("", ""),
) -> NewVersion:
    """Builds the row of a version, with all values derived from its scene.

    Args:
        before: objects of the parent version.
        content: has the entries of `content_of`.
        limits: maximum numbers of versions and of names given by people.
        sizes: see `sizes_in_meters`; None: computed here.
        author: name of the access key; "" for none.
        request: id and digest of the request; "" for none.
    """
    appearances = described(scene.objects, sizes_in_meters(scene) if sizes is None else sizes)
    return NewVersion(
        scene_id=scene_id,
        version=version,
        parent=parent,
        request_id=request[0],
        request_digest=request[1],
        edits=edits,
        **{name: content[name] for name in ("gaussians", "dictionary", "objects")},
        names=names_between(before, scene.objects, appearances, limits.max_known_names),
        author=author,
        scaling=scaling_to_json(scene.scaling),
        alignment=alignment_to_json(scene.alignment),
        quality=SceneFacts(changed_by=scene.facts.changed_by).with_quality({}),
        # All versions of a draft are kept, to be reapplied to the scene that replaces it.
        max_versions=None if scene.facts.draft else limits.max_versions,
    )


def content_of(scene: Scene, counts: Sequence[int] | None = None) -> dict[str, Any]:
    """Content columns of a version's row; `counts` are Gaussians per label, if known."""
    if counts is None:
        counts = np.bincount(label_gaussians(scene).classes, minlength=len(scene.dictionary) + 1).tolist()
    dictionary = [
        {"label_id": number, **asdict(entry), "gaussian_count": counts[number]}
        for number, entry in enumerate(scene.dictionary.entries, start=1)
    ]
    return {"gaussians": len(scene.gaussians), "objects": object_count(objects_of(scene)), "dictionary": dictionary}
