"""Stages of jobs that name objects of finished scenes: second look, and server's captioner.

They look at the version at the job's start, and name objects in the current one.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from fastsplat.service.capture.photos.scene_photos import share_photos
from fastsplat.service.common.progress import Progress, ProgressEvent
from fastsplat.service.jobs.look_again import Sightings, look_for, name_sightings
from fastsplat.service.jobs.nameless_objects import said_by, sheets_of
from fastsplat.service.jobs.new_versions import content_of
from fastsplat.service.perception.text.text_encoders import open_text_encoder
from fastsplat.service.query.edits.suggested_names import MAX_SUGGESTED, suggest_names
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.artefact.scene import Scene
from fastsplat.service.scene.artefact.scene_files import read_scene, write_scene
from fastsplat.service.scene.formats.ply import write_ply
from fastsplat.service.store.blobs.blobs import remove
from fastsplat.workers.job.protocol import Job, Stage
from fastsplat.workers.job.results import intact
from fastsplat_contract.codec.json_codec import from_plain, to_plain
from fastsplat_contract.jobs.look_again import LookAgainIn
from fastsplat_contract.jobs.name_suggestions import CaptionerResult, SuggestIn
from fastsplat_contract.messages.contact_sheets import ContactSheet
from fastsplat_contract.messages.scenes import Edit

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


_SAID = "said.json"


def _ask(job: Job, folder: Path, progress: Progress) -> None:
    """Stage "asking": queries the captioner, bounded in time and requests."""

    def sheets() -> Iterator[ContactSheet]:
        for number, sheet in enumerate(sheets_of(open_current(job), job.upload, job.version), start=1):
            yield sheet
            progress(ProgressEvent("asking", 0.5, f"asked about {number} contact sheets of objects"))

    said = said_by(job.settings.captioner, sheets())
    result = CaptionerResult(len(said.names), said.objects, said.refused, said.problem, "")
    answer = {"names": to_plain(SuggestIn(said.names)), "result": to_plain(result)}
    (folder / _SAID).write_text(json.dumps(answer))


def _suggest(job: Job, folder: Path, progress: Progress) -> None:
    """Stage "suggesting": adds suggestions to existing objects; without any publishes nothing."""
    path = job.result("asking") / _SAID
    with intact(path):
        answer = json.loads(path.read_text())
        names = from_plain(SuggestIn, answer["names"]).suggestions[:MAX_SUGGESTED]
    index = open_current(job)
    there = {obj.id for obj in index.objects.listed_with_parts}
    names = tuple(suggestion for suggestion in names if suggestion.object_id in there)
    progress(ProgressEvent("suggesting", 0.5, f"{len(names)} names suggested"))
    result = {**answer["result"], "suggested": len(names)}
    if not names:
        summary = {"parent": job.version, "edits": [], "result": result}
        (folder / "summary.json").write_text(json.dumps(summary))
        return
    edits = [to_plain(Edit("suggest", suggestions=names))]
    write_renamed(job, suggest_names(index.objects, names), folder, {"edits": edits, "result": result})


ASK_CAPTIONER: Mapping[str, Stage] = {"asking": _ask, "suggesting": _suggest}
