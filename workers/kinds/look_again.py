"""Stages of a job that searches a finished scene for new names.

It searches renderings of the version at the job's start, and names objects in the current one.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from fastsplat.service.capture.photos.scene_photos import share_photos
from fastsplat.service.common.progress import Progress, ProgressEvent
from fastsplat.service.jobs.look_again import Sightings, look_for, name_sightings
from fastsplat.service.jobs.new_versions import content_of
from fastsplat.service.perception.text.text_encoders import open_text_encoder
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.artefact.scene import Scene
from fastsplat.service.scene.artefact.scene_files import read_scene, write_scene
from fastsplat.service.scene.formats.ply import write_ply
from fastsplat.service.store.blobs.blobs import remove
from fastsplat.workers.job.protocol import Job, Stage
from fastsplat.workers.job.results import intact
from fastsplat_contract.codec.json_codec import from_plain, to_plain
from fastsplat_contract.jobs.look_again import LookAgainIn

_SIGHTINGS = "sightings.json"
_PICTURES = "pictures"


def _look(job: Job, folder: Path, progress: Progress) -> None:
    """Stage "looking": finds sightings of the job's texts."""
    order, index = from_plain(LookAgainIn, dict(job.order)), open_current(job)
    (folder / _PICTURES).mkdir()
    sightings = look_for(index, order.texts, job.settings, folder / _PICTURES, progress)
    remove(folder / _PICTURES)
    (folder / _SIGHTINGS).write_text(json.dumps(asdict(sightings)))


def _name(job: Job, folder: Path, progress: Progress) -> None:
    """Stage "naming": writes the current version with the sighted names."""
    path = job.result("looking") / _SIGHTINGS
    with intact(path):
        values = json.loads(path.read_text())
        found = {int(object_id): names for object_id, names in values.pop("found").items()}
        texts, views = tuple(values.pop("texts")), tuple(values.pop("views"))
        sightings = Sightings(texts=texts, views=views, found=found, **values)
    index = open_current(job)
    scene, result = name_sightings(index, sightings, job.settings)
    progress(ProgressEvent("naming", 0.4, f"{len(result.named)} named, {len(result.suggested)} suggested"))
    write_renamed(job, scene, folder, {"result": to_plain(result)})


LOOK_AGAIN: Mapping[str, Stage] = {"looking": _look, "naming": _name}


def write_renamed(job: Job, scene: Scene, folder: Path, more: Mapping[str, Any]) -> None:
    """Writes the current version with other names, for publication.

    `more` has "result" for `summary.json`, and "edits" unless the job's kind describes them.
    """
    write_scene(scene, folder / "artefact")
    try:
        os.link(job.upload / "scene.ply", folder / "scene.ply")  # the Gaussians are the same
    except OSError:  # no hard links
        write_ply(scene.gaussians, folder / "scene.ply")
    share_photos(job.upload, folder)
    (folder / "summary.json").write_text(json.dumps({"parent": job.version, **content_of(scene), **more}))


def open_current(job: Job) -> SceneIndex:
    """Opens the version that was current when the trainer started."""
    scene = read_scene(job.upload / "artefact")
    encoder = open_text_encoder(scene.text_encoder[0], job.settings.models)
    return SceneIndex(scene, encoder, job.settings.query)
