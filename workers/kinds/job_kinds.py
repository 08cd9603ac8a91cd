"""Kinds of job: stages, inputs, code and publication."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from fastsplat.service.store.repositories.scene_repository import order_job
from fastsplat.workers.job.claimed_job import ClaimedJob
from fastsplat_contract.codec.json_codec import from_plain, to_plain
from fastsplat_contract.jobs.operations import OperationKind
from fastsplat_contract.messages.scenes import Edit


@dataclass(frozen=True)
class JobKind:
    """A kind of job; its functions have names, by which a launcher sends them to other processes.

    Attributes:
        publish: publishes the last stage's result if needed, and completes the operation. Raises `ConflictError` to
            redo the last stage because the scene has a new version, `NotFoundError` if it was deleted, `OSError` if the
            disk is full.
    """

    stages: tuple[str, ...]  # in order
    # Folder of the validated upload, or of the finished scene's current version, and that version; `NotFoundError`.
    sources: Callable[[ClaimedJob], tuple[Path, str]]
    run: str  # "module:name" of `Stage` functions by stage, imported only by trainers
    publish: Callable[[ClaimedJob, str], None]
    asks_captioner: bool = False  # pass captioner settings to trainers, given consent


def _publish_scene(job: ClaimedJob, stage: str) -> None:
    scene_id, project = job.scene_id, job.claim.operation.project
    job.publish_scene(stage, order_job("ask_captioner", scene_id, "", {}, project) if job.may_ask_captioner() else None)


def _publish_version(job: ClaimedJob, stage: str) -> None:
    # Imported only if a job makes a version.
    from fastsplat.service.jobs.new_versions import new_version
    from fastsplat.service.scene.artefact.scene_files import read_scene

    folder = job.publish(stage, "summary.json")
    summary = json.loads((folder / "summary.json").read_text())
    result = {**summary["result"], "version": job.run_id}
    of_job = {"action": job.claim.operation.kind, "texts": result.get("texts", ())}
    new = new_version(
        job.scene_id,
        job.run_id,
        summary["parent"],
        summary.get("edits") or [to_plain(from_plain(Edit, of_job))],
        read_scene(job.current_version()[0] / "artefact").objects,  # its parent, otherwise publication fails
        read_scene(folder / "artefact"),
        summary,
        job.calls,
    )
    job.succeed_with_version(new, result)


def _publish_suggestions(job: ClaimedJob, stage: str) -> None:
    path = job.folder / stage / "summary.json"
    summary = json.loads(path.read_text()) if path.exists() else None  # publication moves it
    if summary is None or summary["edits"]:
        _publish_version(job, stage)
    else:
        job.succeed_with_version(None, {**summary["result"], "version": summary["parent"]})


KINDS: Mapping[OperationKind, JobKind] = {
    "create_scene": JobKind(
        stages=("capture", "perception", "training", "export"),
        sources=ClaimedJob.upload,
        run="fastsplat.workers.kinds.create_scene:STAGES",
        publish=_publish_scene,
    ),
    "look_again": JobKind(
        stages=("looking", "naming"),
        sources=ClaimedJob.current_version,
        run="fastsplat.workers.kinds.naming:LOOK_AGAIN",
        publish=_publish_version,
    ),
    "ask_captioner": JobKind(
        stages=("asking", "suggesting"),
        sources=ClaimedJob.current_version,
        run="fastsplat.workers.kinds.naming:ASK_CAPTIONER",
        publish=_publish_suggestions,
        asks_captioner=True,
    ),
}
