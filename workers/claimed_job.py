"""Durable state of a claimed job, in rows and files. Its calls wait while database or object store are away."""

from __future__ import annotations

import json
import logging
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from fastsplat.service.settings import CallSettings
from fastsplat.service.store.blobs import remove
from fastsplat.service.store.claims import Claim, FencedError, JobRequest
from fastsplat.service.store.codec import options_from_json
from fastsplat.service.store.records import NewJob
from fastsplat.service.store.scene_repository import no_scene
from fastsplat.service.store.store import Store
from fastsplat.service.store.version_repository import NewVersion
from fastsplat.workers.job_outcome import JobOutcome
from fastsplat.workers.made_scenes import (
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
from fastsplat.workers.patience import at_once, patient
from fastsplat.workers.results import KEPT, PHOTOS
from fastsplat_contract.errors import ConflictError, DatabaseError, NotFoundError, ObjectStoreError
from fastsplat_contract.operations import SceneOptions

logger = logging.getLogger(__name__)


class ClaimedJob:
    """A job and the newest claim of this worker to it.

    Methods that write raise `FencedError` once another worker has claimed the job, or it is over. All but `report` and
    `poll_requests` wait for up to ten minutes while the database or the object store does not answer, then raise
    `DatabaseError` or `ObjectStoreError`.
    """

    def __init__(self, store: Store, claim: Claim, calls: CallSettings, namer_host: str = "") -> None:
        self.calls = calls
        self._jobs = store.jobs
        self._versions = store.versions
        self._scenes = store.scenes
        self._projects, self._namer_host = store.projects, namer_host
        self._blobs = store.blobs
        self.claim = claim
        self.id = claim.operation.id
        self.run_id = claim.operation.run_id
        self.scene_id = claim.operation.scene_id
        self._progress_files = dict(claim.operation.progress_files or {})
        self._older_files: dict[str, str] = {}
        self._noted: str | None = None
        self._drafted = claim.operation.makes_scene  # or it may be: an earlier attempt may have published one
        self._carried: Sequence[str] = ()

    @property
    def starts(self) -> int:
        """Starts since the job last came further than before that ended in a crash, this one included."""
        return self.claim.operation.starts

    @property
    def options(self) -> SceneOptions:
        """What the user chose."""
        operation = self.claim.operation
        return options_from_json({**operation.options, "priority": operation.priority})

    @property
    def folder(self) -> Path:
        """The work folder, shared by all attempts."""
        return self._blobs.job(self.run_id)

    @property
    def log(self) -> Path:
        """File of the trainers' stderr."""
        return self._blobs.log(self.id)

    @patient
    def upload(self) -> Path:
        """Folder of the validated upload, on this machine."""
        folder = self._blobs.fetch_upload(self.claim.operation.upload_id)
        return folder / str(self.claim.operation.options["validated"])

    @patient
    def current_version(self) -> tuple[Path, str]:
        """Folder, on this machine, and name of the scene's current version.

        Raises:
            NotFoundError: there is no such scene (any more).
        """
        _, version, _ = self._scenes.current_version(self.scene_id)
        current = self._blobs.fetch_version(self.scene_id, version)
        if current is None:
            raise no_scene(self.scene_id)
        return current, version

    def report(self, stages: Sequence[Mapping[str, Any]], *, starts: int | None = None) -> frozenset[JobRequest]:
        """Write progress. Returns what was asked of the job, as far as is known: does not wait.

        Where the job has come further than before, `starts` is how many count from then on; else None.
        """
        return at_once(self.id, lambda: self._report(stages, starts))

    def publish_file(self, kind: str, entry: Mapping[str, Any]) -> None:
        """Make a file of the work folder's `progress` the one of its kind that is looked at from the next report on.

        The one before stays for those who read it just then.
        """
        before = self._progress_files.get(kind)
        try:
            self._blobs.keep_progress_file(self.run_id, entry["file"])
            if kind in self._older_files:
                self._blobs.drop_progress_file(self.run_id, self._older_files.pop(kind))
        except ObjectStoreError as error:
            logger.warning("job %s: a %s is not shown: %s", self.id, kind, error.message)
            return
        number = 1 if before is None else before["info"]["number"] + 1
        if before is not None:
            self._older_files[kind] = before["file"]
        self._progress_files[kind] = {"file": entry["file"], "info": {**entry["info"], "number": number}}

    def publish_draft(self, entry: Mapping[str, Any]) -> None:
        """Make a draft, a folder of the work folder's `drafts`, the scene's current version; the next report tells it.
        One that cannot be published now, as when the scene is being edited, is left out: does not wait."""
        name = str(entry["file"])
        try:
            made = self._published(self.folder / DRAFTS / name, name)
            self._jobs.publish_draft(self.claim, made.summary, made.carried, edited=made.edited)
        except DatabaseError as error:  # it may have written the rows: then the folders are needed
            logger.warning("job %s: draft %s is not shown: %s", self.id, name, error.message)
            return
        except (ConflictError, FencedError, ObjectStoreError, OSError) as error:
            logger.warning("job %s: draft %s is not shown: %s", self.id, name, error)
            with suppress(ObjectStoreError):
                self._drop_published(name)
            return
        self._drafted = True
        before = self._progress_files.get("draft")
        version = made.carried[-1].version if made.carried else name
        info = {**entry["info"], "version": version, "number": 1 if before is None else before["info"]["number"] + 1}
        self._progress_files["draft"] = {"file": name, "info": info}

    def note_edits(self) -> None:
        """Tell the trainer of a job that makes its scene what people have made of the newest draft: does not wait."""
        if not self._drafted:
            return
        with suppress(DatabaseError, ObjectStoreError, NotFoundError, OSError):
            current = self._scenes.current_version(self.scene_id)[1]
            self._drafted = bool(current)
            if current and current != self._noted:
                write_edited(self._edited(), self.folder / EDITS)
                self._noted = current

    @patient
    def note_completed(self, stages: Sequence[Mapping[str, Any]], starts: int) -> None:
        """Write progress in which a stage was completed, and how many starts count from then on."""
        self._report(stages, starts)

    @patient
    def drop_originals(self) -> None:
        """Remove the upload once its photos are read, if that was promised; its folder stays, empty."""
        upload_id = self.claim.operation.upload_id
        if upload_id and self.options.privacy and (self.folder / "capture").is_dir():
            self._blobs.drop_upload(upload_id)
            self._blobs.upload(upload_id).mkdir(parents=True, exist_ok=True)

    @patient
    def note_photos(self) -> None:
        """Write what became of the photos, if the capture stage has said so."""
        path = self.folder / "capture" / PHOTOS
        if path.is_file():
            self._jobs.record_photos(self.claim, json.loads(path.read_text()))

    def poll_requests(self) -> frozenset[JobRequest]:
        """What was asked of the job, as far as is known: does not wait."""
        return at_once(self.id, lambda: self._jobs.check(self.claim))

    @patient
    def is_cancelled(self) -> bool:
        """Whether the job is to be cancelled."""
        return "cancel" in self._jobs.check(self.claim)

    @patient
    def may_ask_namer(self) -> bool:
        """Whether the settings name a namer, and the job's project agreed to its host."""
        return bool(self._namer_host) and self._projects.agreed(self.claim.operation.project) == self._namer_host

    @patient
    def claim_again(self) -> None:
        """Begin another attempt of this worker, whose trainer died."""
        self.claim = self._jobs.claim_again(self.claim)

    @patient
    def release(self) -> None:
        """Give the job back unfinished; its start does not count."""
        self._jobs.release(self.claim)

    @patient
    def is_published(self) -> bool:
        """Whether the last stage's result is published."""
        return bool(self._blobs.fetch_version(self.scene_id, self.run_id))

    @patient
    def publish(self, stage: str, *files: str) -> Path:
        """Move the result of `stage`, the last one, to the scene's folder, unless an earlier attempt did, and check
        `files` of it. Returns where it is, a version whose name is the run's; `OSError` where the disk is full."""
        folder = self._blobs.fetch_version(self.scene_id, self.run_id)
        if folder is None:
            folder = self._blobs.publish(self.folder / stage, self.scene_id, self.run_id)
        self._blobs.check_version(folder, *files)
        return folder

    @patient
    def publish_scene(self, stage: str, follow: NewJob | None) -> None:
        """Publish the result of `stage`, the last one, unless an earlier attempt did; make the scene READY, the
        operation SUCCEEDED, and queue what is to `follow`.

        Raises:
            ConflictError: a draft was edited meanwhile.
            OSError: the disk is full.
        """
        made = self._made(stage)
        more: Mapping[str, Any] = {"edited": made.edited, "result": made.result, "follow": follow}
        self._drop_versions(self._jobs.succeed(self.claim, made.summary, made.carried, **more))

    @patient
    def succeed_with_version(self, new: NewVersion | None, result: Mapping[str, Any]) -> None:
        """Add a published version, None for none, to the finished scene and make the operation SUCCEEDED; errors as
        `JobRepository.succeed_with_version`."""
        self._drop_versions(self._jobs.succeed_with_version(self.claim, new, result))

    @patient
    def drop_result(self, stage: str) -> None:
        """Remove the result of `stage`, the last one, here and where it was published, so that it is made again;
        a scene that was not published yet is kept for that."""
        result, kept = self.folder / stage, self.folder / f"{stage}{KEPT}"
        if self.claim.operation.makes_scene and result.is_dir():
            remove(kept)
            result.rename(kept)
        remove(result)
        self._drop_published(self.run_id)

    @patient
    def cancel(self) -> None:
        """Make the operation CANCELLED."""
        self._jobs.cancelled(self.claim)

    @patient
    def fail(self, error: Mapping[str, Any]) -> None:
        """Make the operation FAILED with an `OperationError` as JSON."""
        self._jobs.fail(self.claim, error)

    def clean_up(self, outcome: JobOutcome) -> None:
        """Remove the files that an ended job does not need; what cannot be removed is left to the periodic cleanup.

        The upload of a job that failed or was cancelled stays for a retry, unless its scene was deleted or its photos
        were promised not to be stored.
        """
        with suppress(ObjectStoreError):
            self._blobs.drop_job(self.run_id)
        if outcome.state != "failed":
            remove(self.log)
        with suppress(DatabaseError, ObjectStoreError):
            deleted = bool(self._jobs.unknown_scenes([self.scene_id]))
            promised = self.options.privacy is not None  # then no photo as sent outlives the attempt to read it
            if self.claim.operation.upload_id and (deleted or promised or outcome.state == "done"):
                self._blobs.drop_upload(self.claim.operation.upload_id)
            if deleted and self.claim.operation.makes_scene:
                self._blobs.drop_scene(self.scene_id)
            elif deleted or outcome.state != "done":  # only what this job made
                self._blobs.drop_version(self.scene_id, self.run_id)

    def _made(self, stage: str) -> MadeScene:
        """Publish the result of `stage`, the last one, unless an earlier attempt did; errors as `publish_scene`."""
        made = self._published(self.folder / stage, self.run_id, check=True)
        folder = self._version_or(self.run_id, self.folder / stage)
        self._blobs.check_version(folder, SUMMARY, "stage.json")
        made.summary.quality["stage_seconds"][stage] = json.loads((folder / "stage.json").read_text())["seconds"]
        return made

    def _published(self, folder: Path, version: str, *, check: bool = False) -> MadeScene:
        """Publish the folders of a scene, and those of its edits, as far as they are not; with `check`, unless a
        draft was edited since: `ConflictError`."""
        self._carried = ()
        place = self._version_or(version, folder)
        made = read_made(
            place, self.scene_id, version, self.calls, lambda name: self._version_or(name, place / CARRIED / name)
        )
        if check:
            edited = self._edited()
            if made.edited != (edited.versions[-1].version if edited else ""):
                raise ConflictError("a draft was edited meanwhile", field="version")
        self._carried = tuple(new.version for new in made.carried)
        for name in self._carried:
            if (place / CARRIED / name).is_dir():
                self._blobs.publish(place / CARRIED / name, self.scene_id, name)
        if place == folder:
            self._blobs.publish(folder, self.scene_id, version)
        return made

    def _version_or(self, version: str, folder: Path) -> Path:
        return self._blobs.fetch_version(self.scene_id, version) or folder

    def _edited(self) -> EditedDraft | None:
        """What people have made of the newest draft."""
        scene = self._scenes.scene(self.scene_id)
        records = self._versions.of(scene) if scene.version else ()
        return edited_draft(records, lambda name: self._version_or(name, Path()))

    def _drop_published(self, version: str) -> None:
        for name in (version, *self._carried):
            self._blobs.drop_version(self.scene_id, name)

    def _drop_versions(self, versions: Sequence[str]) -> None:
        with suppress(ObjectStoreError):  # what stays, the periodic cleanup removes
            for old in versions:
                self._blobs.drop_version(self.scene_id, old)

    def _report(self, stages: Sequence[Mapping[str, Any]], starts: int | None) -> frozenset[JobRequest]:
        requests = self._jobs.report(self.claim, stages, starts=starts, progress_files=self._progress_files)
        if starts is not None:
            self.claim = replace(self.claim, operation=replace(self.claim.operation, starts=starts))
        return requests
