"""Durable state of a claimed job, in the database and files."""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import wraps
from pathlib import Path
from typing import Any, Literal, ParamSpec, TypeVar

from fastsplat.service.settings import CallSettings
from fastsplat.service.store.blobs.blobs import remove
from fastsplat.service.store.queue.claims import Claim, FencedError, JobRequest
from fastsplat.service.store.repositories.scene_repository import no_scene
from fastsplat.service.store.repositories.version_repository import NewVersion
from fastsplat.service.store.rows.codec import options_from_json
from fastsplat.service.store.rows.records import NewJob
from fastsplat.service.store.store import Store
from fastsplat.workers.job.made_scenes import (
    CARRIED,
    DRAFTS,
    EDITS,
    SUMMARY,
    EditedDraft,
    MadeScene,
    edited_draft,
    read_made,
    write_edited,
)
from fastsplat.workers.job.results import PHOTOS, SPARE_SUFFIX, finished_by
from fastsplat_contract.errors import ArtefactError, ConflictError, DatabaseError, NotFoundError, ObjectStoreError
from fastsplat_contract.jobs.operations import SceneOptions

logger = logging.getLogger(__name__)

T = TypeVar("T")
P = ParamSpec("P")
_PATIENCE_S = 600.0
_RETRY_S = 1.0


def patient(method: Callable[P, T]) -> Callable[P, T]:
    """Retries a call for up to ten minutes during an outage."""

    @wraps(method)
    def call(*args: P.args, **kwargs: P.kwargs) -> T:
        deadline = time.monotonic() + _PATIENCE_S
        while True:
            try:
                return method(*args, **kwargs)
            except (DatabaseError, ObjectStoreError):
                if time.monotonic() > deadline:
                    raise
                time.sleep(_RETRY_S)

    return call


class ClaimedJob:
    """A job with this worker's newest claim to it.

    Writes raise `FencedError` once another worker has claimed the job, or it has ended. Methods marked `patient` retry
    for ten minutes during an outage of the database or object store, then raise `DatabaseError` or `ObjectStoreError`.
    """

    def __init__(self, store: Store, claim: Claim, calls: CallSettings, captioner_host: str = "") -> None:
        self.calls = calls
        self._jobs = store.jobs
        self._versions = store.versions
        self._scenes = store.scenes
        self._projects, self._captioner_host = store.projects, captioner_host
        self._blobs = store.blobs
        self.claim = claim
        self.id = claim.operation.id
        self.run_id = claim.operation.run_id
        self.scene_id = claim.operation.scene_id
        self._progress_files = dict(claim.operation.progress_files or {})
        self._older_files: dict[str, str] = {}
        self._noted: str | None = None
        self._drafted = claim.operation.makes_scene  # an earlier attempt may have published a draft
        self._carried: Sequence[str] = ()

    @property
    def starts(self) -> int:
        """Starts that ended in a crash since the last progress, plus this one."""
        return self.claim.operation.starts

    @property
    def options(self) -> SceneOptions:
        operation = self.claim.operation
        return options_from_json({**operation.options, "priority": operation.priority})

    @property
    def folder(self) -> Path:
        return self._blobs.job(self.run_id)

    @property
    def log(self) -> Path:
        return self._blobs.log(self.id)

    @patient
    def upload(self) -> tuple[Path, str]:
        folder = self._blobs.fetch_upload(self.claim.operation.upload_id)
        return folder / str(self.claim.operation.options["validated"]), ""

    @patient
    def current_version(self) -> tuple[Path, str]:
        """Fetches the scene's current version; raises `NotFoundError` if deleted."""
        _, version, _ = self._scenes.current_version(self.scene_id)
        current = self._blobs.fetch_version(self.scene_id, version)
        if current is None:
            raise no_scene(self.scene_id)
        return current, version

    def requests(self, stages: Sequence[Mapping[str, Any]] | None, starts: int | None = None) -> frozenset[JobRequest]:
        """Returns known requests, without retry: a database outage only costs progress reports.

        Args:
            stages: progress to write; None writes nothing.
            starts: new count of starts, once the job is ahead of earlier attempts.
        """
        try:
            return self._jobs.check(self.claim) if stages is None else self._report(stages, starts)
        except DatabaseError as error:
            logger.warning("job %s: %s; will ask again", self.id, error.message)
            return frozenset()

    def publish_file(self, kind: str, entry: Mapping[str, Any]) -> None:
        """Publishes a progress file with the next report; keeps the previous one for current readers."""
        before = self._progress_files.get(kind)
        try:
            self._blobs.keep_progress_file(self.run_id, entry["file"])
            if kind in self._older_files:
                self._blobs.drop_progress_file(self.run_id, self._older_files.pop(kind))
        except ObjectStoreError as error:
            logger.warning("job %s: a %s is not shown: %s", self.id, kind, error.message)
            return
        if before is not None:
            self._older_files[kind] = before["file"]
        self._note_file(kind, entry["file"], entry["info"])

    def publish_draft(self, entry: Mapping[str, Any]) -> None:
        """Publishes a draft as the current version, or skips it, without retry."""
        name = str(entry["file"])
        try:
            scene = self._published(self.folder / DRAFTS / name, name)
            self._jobs.publish_draft(self.claim, scene.summary, scene.carried, edited=scene.edited)
        except DatabaseError as error:  # the rows may be written, and then need the folders
            logger.warning("job %s: draft %s is not shown: %s", self.id, name, error.message)
            return
        except (ConflictError, FencedError, ObjectStoreError, OSError) as error:
            logger.warning("job %s: draft %s is not shown: %s", self.id, name, error)
            with suppress(ObjectStoreError):
                self._drop_published(name)
            return
        self._drafted = True
        version = scene.carried[-1].version if scene.carried else name
        self._note_file("draft", name, {**entry["info"], "version": version})

    def note_edits(self) -> None:
        """Tells the trainer about edits of the newest draft, without retry."""
        if not self._drafted:
            return
        with suppress(DatabaseError, ObjectStoreError, NotFoundError, OSError):
            current = self._scenes.current_version(self.scene_id)[1]
            self._drafted = bool(current)
            if current and current != self._noted:
                write_edited(self._edited(), self.folder / EDITS)
                self._noted = current

    @patient
    def fetch_results(self, attempts: Mapping[str, int]) -> None:
        """Brings the stored results of stages here, by the attempts that finished them.

        A work folder that goes on from other results, as of an attempt whose machine was cut off, is deleted before.
        """
        places = [(self.folder / stage, stage, attempt) for stage, attempt in attempts.items()]
        if any(result.is_dir() and finished_by(result) != attempt for result, _, attempt in places):
            remove(self.folder)
        for result, stage, attempt in places:
            try:
                if not result.is_dir() and not self._blobs.fetch_result(self.run_id, stage, attempt):
                    return
            except (ArtefactError, OSError) as error:  # from this one on they are made again
                logger.warning("job %s: the result of %s cannot be fetched: %s", self.id, stage, error)
                return

    def keep_result(self, stage: str) -> int:
        """Stores a stage's result for workers elsewhere, without retry.

        Returns the attempt that finished it; 0 if it is not stored.
        """
        attempt = finished_by(self.folder / stage)
        try:
            self._blobs.keep_result(self.run_id, stage, attempt)
        except (ObjectStoreError, OSError) as error:
            logger.warning("job %s: the result of %s is on this machine alone: %s", self.id, stage, error)
            return 0
        return attempt

    def keep_log(self) -> None:
        """Stores the trainers' log as it is now, without retry."""
        with suppress(ObjectStoreError):
            self._blobs.keep_log(self.id)

    @patient
    def drop_originals(self) -> None:
        """Deletes the upload once its photos are read, if privacy was promised."""
        upload_id = self.claim.operation.upload_id
        if upload_id and self.options.privacy and (self.folder / "capture").is_dir():
            self._blobs.drop_upload(upload_id)
            self._blobs.upload(upload_id).mkdir(parents=True, exist_ok=True)

    @patient
    def note_photos(self) -> None:
        """Records the capture stage's result for each photo."""
        path = self.folder / "capture" / PHOTOS
        if path.is_file():
            self._jobs.record_photos(self.claim, json.loads(path.read_text()))

    @patient
    def is_cancelled(self) -> bool:
        return "cancel" in self._jobs.check(self.claim)

    @patient
    def may_ask_captioner(self) -> bool:
        """The settings name a captioner, and the project agreed to its host."""
        return (
            bool(self._captioner_host) and self._projects.agreed(self.claim.operation.project) == self._captioner_host
        )

    @patient
    def release(self, pause_s: float | None = None) -> None:
        """Returns the job unfinished, as `JobRepository.release`."""
        self._jobs.release(self.claim, pause_s)

    @patient
    def is_published(self) -> bool:
        return bool(self._blobs.fetch_version(self.scene_id, self.run_id))

    @patient
    def publish(self, stage: str, *files: str) -> Path:
        """Publishes the last stage's result as version `run_id`, if needed, and checks `files`.

        Raises:
            OSError: the disk is full.
        """
        version = self.scene_id, self.run_id
        folder = self._blobs.fetch_version(*version) or self._blobs.publish(self.folder / stage, *version)
        self._blobs.check_version(folder, *files)
        return folder

    @patient
    def publish_scene(self, stage: str, follow: NewJob | None) -> None:
        """Publishes the last stage's result, completes scene and operation, and queues `follow`.

        Raises:
            ConflictError: a draft was edited meanwhile.
            OSError: the disk is full.
        """
        scene = self._published(self.folder / stage, self.run_id, check=True)
        folder = self._version_or(self.run_id, self.folder / stage)
        self._blobs.check_version(folder, SUMMARY, "stage.json")
        scene.summary.quality["stage_seconds"][stage] = json.loads((folder / "stage.json").read_text())["seconds"]
        more: Mapping[str, Any] = {"edited": scene.edited, "result": scene.result, "follow": follow}
        self._drop_versions(self._jobs.succeed(self.claim, scene.summary, scene.carried, **more))

    @patient
    def succeed_with_version(self, new: NewVersion | None, result: Mapping[str, Any]) -> None:
        """Completes the operation with a published version, if any; raises as `JobRepository.succeed_with_version`."""
        self._drop_versions(self._jobs.succeed_with_version(self.claim, new, result))

    @patient
    def drop_result(self, stage: str) -> None:
        """Deletes the last stage's result to redo it; keeps an unpublished scene."""
        result, spare = self.folder / stage, self.folder / f"{stage}{SPARE_SUFFIX}"
        if self.claim.operation.makes_scene and result.is_dir():
            remove(spare)
            result.rename(spare)
        remove(result)
        self._drop_published(self.run_id)

    @patient
    def end(self, error: Mapping[str, Any] | None) -> None:
        """Marks the operation FAILED with an `OperationError` as JSON, or CANCELLED."""
        self._jobs.cancelled(self.claim) if error is None else self._jobs.fail(self.claim, error)

    def clean_up(self, outcome: JobOutcome) -> None:
        """Deletes files that an ended job does not need; leftovers go with the periodic cleanup.

        The upload of a failed or cancelled job is kept for a retry, unless its scene was deleted or privacy was
        promised.
        """
        with suppress(ObjectStoreError):
            self._blobs.drop_job(self.run_id)
            if outcome.state != "failed":
                self._blobs.drop_log(self.id)
        with suppress(DatabaseError, ObjectStoreError):
            deleted = bool(self._jobs.unknown_scenes([self.scene_id]))
            promised = self.options.privacy is not None  # originals then do not outlive the attempt to read them
            if self.claim.operation.upload_id and (deleted or promised or outcome.state == "done"):
                self._blobs.drop_upload(self.claim.operation.upload_id)
            if deleted and self.claim.operation.makes_scene:
                self._blobs.drop_scene(self.scene_id)
            elif deleted or outcome.state != "done":  # only what this job made
                self._blobs.drop_version(self.scene_id, self.run_id)

    def _note_file(self, kind: str, file: str, info: Mapping[str, Any]) -> None:
        number = self._progress_files[kind]["info"]["number"] + 1 if kind in self._progress_files else 1
        self._progress_files[kind] = {"file": file, "info": {**info, "number": number}}

    def _published(self, folder: Path, version: str, *, check: bool = False) -> MadeScene:
        """Publishes a scene's folders and edits; with `check` raises `ConflictError` after edits."""
        self._carried = ()
        place = self._version_or(version, folder)
        scene = read_made(
            place, self.scene_id, version, self.calls, lambda name: self._version_or(name, place / CARRIED / name)
        )
        if check:
            edited = self._edited()
            if scene.edited != (edited.versions[-1].version if edited else ""):
                raise ConflictError("a draft was edited meanwhile", field="version")
        self._carried = tuple(new.version for new in scene.carried)
        for name in self._carried:
            if (place / CARRIED / name).is_dir():
                self._blobs.publish(place / CARRIED / name, self.scene_id, name)
        if place == folder:
            self._blobs.publish(folder, self.scene_id, version)
        return scene

    def _version_or(self, version: str, folder: Path) -> Path:
        return self._blobs.fetch_version(self.scene_id, version) or folder

    def _edited(self) -> EditedDraft | None:
        scene = self._scenes.scene(self.scene_id)
        records = self._versions.of(scene) if scene.version else ()
        return edited_draft(records, lambda name: self._version_or(name, Path()))

    def _drop_published(self, version: str) -> None:
        for name in (version, *self._carried):
            self._blobs.drop_version(self.scene_id, name)

    def _drop_versions(self, versions: Sequence[str]) -> None:
        with suppress(ObjectStoreError):  # leftovers go with the periodic cleanup
            for old in versions:
                self._blobs.drop_version(self.scene_id, old)

    def _report(self, stages: Sequence[Mapping[str, Any]], starts: int | None) -> frozenset[JobRequest]:
        """Writes progress and, unless None, the new start count."""
        requests = self._jobs.report(self.claim, stages, starts=starts, progress_files=self._progress_files)
        if starts is not None:
            self.claim = replace(self.claim, operation=replace(self.claim.operation, starts=starts))
        return requests

    note_completed = patient(_report)


@dataclass(frozen=True)
class JobOutcome:
    """Outcome of a job or stage."""

    state: Literal["done", "cancelled", "failed"]
    error: Mapping[str, Any] | None = None  # `OperationError` as JSON if failed


DONE = JobOutcome("done")
CANCELLED = JobOutcome("cancelled")


def failed(error: Mapping[str, Any]) -> JobOutcome:
    return JobOutcome("failed", error)
