"""The stages of a job that looks again at a finished scene: a look at the version of then, names for the one of now."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from fastsplat.service.capture.photos.scene_photos import share_photos
from fastsplat.service.common.progress import Progress, ProgressEvent
from fastsplat.service.look_again import Sightings, look_for, name_sightings
from fastsplat.service.new_versions import content_of
from fastsplat.service.perception.text.open_text_encoder import open_text_encoder
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.ply import write_ply
from fastsplat.service.scene.scene_files import read_scene, write_scene
from fastsplat.service.scene.types import Scene
from fastsplat.service.store.blobs import remove
from fastsplat.workers.protocol import Job, Stage
from fastsplat.workers.results import intact
from fastsplat_contract.json_codec import from_plain, to_plain
from fastsplat_contract.look_again_messages import LookAgainIn

_SIGHTINGS = "sightings.json"
_PICTURES = "pictures"


def _look(job: Job, folder: Path, progress: Progress) -> None:
    """Stage "looking": the sightings of the job's texts."""
    order, index = from_plain(LookAgainIn, dict(job.order)), open_current(job)
    (folder / _PICTURES).mkdir()
    sightings = look_for(index, order.texts, job.settings, folder / _PICTURES, progress)
    remove(folder / _PICTURES)
    (folder / _SIGHTINGS).write_text(json.dumps(asdict(sightings)))


def _name(job: Job, folder: Path, progress: Progress) -> None:
    """Stage "naming": the current version with the names of what was sighted, as a folder to be published.

    `summary.json` says of which version it was made, and what to tell the caller.
    """
    path = job.result("looking") / _SIGHTINGS
    with intact(path):
        values = json.loads(path.read_text())
        found = {int(thing_id): names for thing_id, names in values.pop("found").items()}
        texts, views = tuple(values.pop("texts")), tuple(values.pop("views"))
        sightings = Sightings(texts=texts, views=views, found=found, **values)
    index = open_current(job)
    scene, result = name_sightings(index, sightings, job.settings)
    progress(ProgressEvent("naming", 0.4, f"{len(result.named)} named, {len(result.suggested)} suggested"))
    write_renamed(job, scene, folder, {"result": to_plain(result)})


STAGES: Mapping[str, Stage] = {"looking": _look, "naming": _name}


def write_renamed(job: Job, scene: Scene, folder: Path, more: Mapping[str, Any]) -> None:
    """Write the current version with other names as a folder to be published.

    Args:
        job: of the version.
        scene: what it is now, its Gaussians as they were.
        folder: to write into.
        more: for `summary.json`: the "result", and "edits" if the version was made by others than the job's kind.
    """
    write_scene(scene, folder / "artefact")
    try:
        os.link(job.upload / "scene.ply", folder / "scene.ply")  # the Gaussians are the same
    except OSError:  # not every file system has links
        write_ply(scene.gaussians, folder / "scene.ply")
    share_photos(job.upload, folder)
    (folder / "summary.json").write_text(json.dumps({"parent": job.version, **content_of(scene), **more}))


def open_current(job: Job) -> SceneIndex:
    """The version of the scene that is current as the job's trainer starts."""
    scene = read_scene(job.upload / "artefact")
    encoder = open_text_encoder(scene.text_encoder[0], job.settings.models)
    return SceneIndex(scene, encoder, job.settings.query)
