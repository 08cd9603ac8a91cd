"""What workers write of their jobs. Every write carries the attempt that claimed the job: late ones change nothing."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any

from sqlalchemy import Connection, delete, exists, insert, select, update

from fastsplat.service.store.claims import Claim, FencedError, JobQueue, JobRequest, execute_fenced, fenced, uncancelled
from fastsplat.service.store.damaged_rows import each_readable
from fastsplat.service.store.made_scenes import publish_made_within
from fastsplat.service.store.photo_repository import record_photos
from fastsplat.service.store.records import (
    AGAIN_AFTER,
    EXCLUDED,
    RELEASED,
    RESULT,
    RETRIES,
    NewJob,
    OperationRecord,
    SceneSummary,
)
from fastsplat.service.store.scene_repository import as_operation, no_operation, no_upload, queued_row
from fastsplat.service.store.schema import operations, scenes
from fastsplat.service.store.version_repository import NewVersion, publish_within
from fastsplat_contract.errors import NotFoundError

_ENDED = ("SUCCEEDED", "FAILED", "CANCELLED")
_UNFINISHED = ("QUEUED", "RUNNING")
_RETRIED = ("FAILED", "CANCELLED")
_REQUESTED = (operations.c.cancel_requested, operations.c.finish_requested)


class JobRepository(JobQueue):
    """The queue, and what is written of a job; every method is one transaction, and raises `DatabaseError` when the
    database is away."""

    def release(self, claim: Claim) -> None:
        """Give an unfinished job back; its start does not count. Does nothing when fenced."""
        with self._writing() as connection:
            options = {**claim.operation.options, RELEASED: True}
            values = {"starts": operations.c.starts - 1, "options": options, "worker": "", "updated_at": time.time()}
            connection.execute(fenced(claim).values(values))

    def report(
        self,
        claim: Claim,
        stages: Sequence[Mapping[str, Any]],
        *,
        starts: int | None = None,
        progress_files: Mapping[str, Mapping[str, Any]] | None = None,
    ) -> frozenset[JobRequest]:
        """Write progress. Returns what was asked of the job.

        Args:
            claim: of which job.
            stages: one row a stage.
            starts: how many starts count from now on, as the job came further than before; None: as before.
            progress_files: see `OperationRecord`; None: as before.

        Raises:
            FencedError: the claim is no longer the newest, or the operation is over.
        """
        with self._writing() as connection:
            values: dict[str, Any] = {"stages": [dict(stage) for stage in stages], "updated_at": time.time()}
            if starts is not None:
                values["starts"] = starts
            if progress_files is not None:
                values["progress_files"] = {kind: dict(entry) for kind, entry in progress_files.items()}
            execute_fenced(connection, claim, fenced(claim).values(values))
            requested = connection.execute(select(*_REQUESTED).where(operations.c.id == claim.operation.id)).one()
            return _requests(tuple(requested))

    def record_photos(self, claim: Claim, photos: Sequence[Mapping[str, Any]]) -> None:
        """Write what became of the photos of the job's scene, as JSON objects. Raises `FencedError`: as `report`."""
        with self._writing() as connection:
            execute_fenced(connection, claim, fenced(claim).values(updated_at=time.time()))
            record_photos(connection, claim.operation.scene_id, photos)

    def check(self, claim: Claim) -> frozenset[JobRequest]:
        """Look without writing. Returns what was asked of the job. Raises `FencedError`: as `report`."""
        query = select(*_REQUESTED).where(
            operations.c.id == claim.operation.id,
            operations.c.attempt == claim.attempt,
            operations.c.state == "RUNNING",
        )
        with self._reading() as connection:
            requested = connection.execute(query).first()
        if requested is None:
            raise FencedError(claim.operation.id)
        return _requests(tuple(requested))

    def publish_draft(
        self, claim: Claim, summary: SceneSummary, carried: Sequence[NewVersion] = (), *, edited: str = ""
    ) -> None:
        """Make a draft the scene's current version, with edits of the one before it; arguments, errors as `succeed`."""
        with self._writing() as connection:
            self._publish(connection, claim, {}, summary, carried, edited, draft=True)

    def succeed(
        self,
        claim: Claim,
        summary: SceneSummary,
        carried: Sequence[NewVersion] = (),
        *,
        edited: str = "",
        result: Mapping[str, Any] | None = None,
        follow: NewJob | None = None,
    ) -> Sequence[str]:
        """Make the scene READY, in the place of its drafts, and end the operation as SUCCEEDED; both at once.

        Args:
            claim: of which job.
            summary, carried, edited: see `publish_made_within`, as for what it returns.
            result: what became of edits of drafts, as JSON; None for no edits.
            follow: a job on the finished scene, queued with its end.

        Raises:
            FencedError: as `report`; also when a cancellation came first, or the scene was deleted.
            ConflictError: a draft was edited meanwhile.
        """
        with self._writing() as connection:
            told = {} if result is None else {RESULT: dict(result)}
            done = {"state": "SUCCEEDED", "options": {**claim.operation.options, **told}}
            removed = self._publish(connection, claim, done, summary, carried, edited, draft=False)
            ready = update(scenes).where(scenes.c.id == claim.operation.scene_id).values(state="READY")
            execute_fenced(connection, claim, ready)
            if follow is not None:
                connection.execute(insert(operations).values(queued_row(follow)))
        return removed

    def succeed_with_version(self, claim: Claim, new: NewVersion | None, result: Mapping[str, Any]) -> Sequence[str]:
        """Publish a version, None for none, and end the operation, which made it, as SUCCEEDED with its result; both at
        once. Returns the names of the versions that were removed, whose folders are the caller's to remove.

        Raises:
            FencedError: as `report`; also when a cancellation came first.
            ConflictError, NotFoundError: as `publish_within`.
        """
        options = {**claim.operation.options, RESULT: dict(result)}
        with self._writing() as connection:
            done = uncancelled(claim).values(state="SUCCEEDED", options=options, updated_at=time.time())
            execute_fenced(connection, claim, done)
            return publish_within(connection, new)[1] if new is not None else ()

    def fail(self, claim: Claim, error: Mapping[str, Any]) -> None:
        """End the operation as FAILED with its durable reason. Raises `FencedError`: as `report`."""
        self._end(claim, "FAILED", dict(error))

    def cancelled(self, claim: Claim) -> None:
        """End the operation as CANCELLED.

        Raises:
            FencedError: as `report`.
        """
        self._end(claim, "CANCELLED", None)

    def retry(self, operation_id: str, ended_since: float, exclude: Sequence[str] = ()) -> OperationRecord:
        """Queue a failed or cancelled operation again; one in another state stays as it is.

        Args:
            ended_since: seconds since 1970; what ended before has lost its upload.
            exclude: paths of photos of its upload to leave out, beside those of earlier retries.

        Returns:
            The operation as it now is: QUEUED, without stages, error and starts, if it was failed or cancelled.

        Raises:
            NotFoundError: there is no such operation, or its scene or its upload is gone.
        """
        here = operations.c.id == operation_id
        with self._writing() as connection:
            row = connection.execute(select(operations).where(here).with_for_update()).mappings().first()
            if row is None:
                raise no_operation(operation_id)
            record = as_operation(row)
            if record.state not in _RETRIED:
                return record
            scene = scenes.c.id == record.scene_id
            if connection.scalar(select(scenes.c.id).where(scene)) is None:
                raise NotFoundError(f"the scene of operation {operation_id!r} was deleted", field="operation")
            if record.makes_scene:
                connection.execute(update(scenes).where(scene).values(state="TRAINING"))
                if record.updated_at < ended_since:
                    raise no_upload(operation_id)
            options = {
                **record.options,
                RETRIES: record.retries + 1,
                EXCLUDED: sorted({*record.excluded, *exclude}),
                AGAIN_AFTER: record.state.lower(),
            }
            again = {
                "state": "QUEUED", "starts": 0, "stages": [], "error": None, "cancel_requested": False,
                "finish_requested": False, "progress_files": None, "worker": "",
                "options": options, "updated_at": time.time(),
            }  # fmt: skip
            connection.execute(update(operations).where(here).values(again))
            return as_operation(connection.execute(select(operations).where(here)).mappings().one())

    def over(self, run_ids: Sequence[str]) -> frozenset[str]:
        """Which of these runs of operations (`OperationRecord.run_id`) have ended or do not exist; none of an operation
        whose row cannot be read."""
        unfinished = select(operations).where(operations.c.state.not_in(_ENDED))
        with self._reading() as connection:
            rows = connection.execute(unfinished).mappings().all()
        records = {record.id: record.run_id for record in each_readable(rows, as_operation)}
        unreadable = frozenset(row["id"] for row in rows) - records.keys()
        kept = frozenset(records.values()) | {run for run in run_ids if run.partition(".")[0] in unreadable}
        return frozenset(run_ids) - kept

    def delete_ended(self, before: float) -> None:
        """Delete operations that ended before a moment (seconds since 1970) and have no scene (any more)."""
        without_scene = delete(operations).where(
            operations.c.updated_at < before,
            operations.c.state.in_(_ENDED),
            ~exists().where(scenes.c.id == operations.c.scene_id),
        )
        with self._writing() as connection:
            connection.execute(without_scene)

    def uploads(self, ended_since: float) -> tuple[frozenset[str], frozenset[str]]:
        """Uploads that operations need, and those that they need no more.

        Needed are those of queued and running operations, and of those that failed or were cancelled after
        `ended_since` (seconds since 1970) and whose scene was not deleted: they may be retried.
        """
        rows = operations.c
        query = select(rows.upload_id, rows.state, rows.updated_at, scenes.c.id.label("scene")).select_from(
            operations.outerjoin(scenes, scenes.c.id == rows.scene_id)
        )
        with self._reading() as connection:
            stored = connection.execute(query).all()
        needed = frozenset(
            row.upload_id
            for row in stored
            if row.state in _UNFINISHED
            or (row.state in _RETRIED and row.scene is not None and row.updated_at >= ended_since)
        )
        return needed, frozenset(row.upload_id for row in stored) - needed

    def unknown_scenes(self, scene_ids: Sequence[str]) -> frozenset[str]:
        """Which of these scenes do not exist (any more)."""
        with self._reading() as connection:
            return frozenset(scene_ids) - frozenset(connection.scalars(select(scenes.c.id)))

    def lost_scenes(self, scene_ids: Sequence[str], ended_before: float) -> tuple[frozenset[str], frozenset[str]]:
        """Which of these scenes have no row: those of which there are operations, all ended before a moment (seconds
        since 1970), and those of which there is nothing. A scene that is being deleted is neither."""
        with self._reading() as connection:
            rest = frozenset(scene_ids) - frozenset(connection.scalars(select(scenes.c.id)))
            columns = operations.c.scene_id, operations.c.state, operations.c.updated_at
            jobs = connection.execute(select(*columns)).all() if rest else ()
        known = frozenset(job.scene_id for job in jobs)
        open_ones = (job for job in jobs if job.state in _UNFINISHED or job.updated_at >= ended_before)
        return (rest & known) - frozenset(job.scene_id for job in open_ones), rest - known

    @staticmethod
    def _publish(
        connection: Connection,
        claim: Claim,
        values: Mapping[str, Any],
        summary: SceneSummary,
        carried: Sequence[NewVersion],
        edited: str,
        *,
        draft: bool,
    ) -> Sequence[str]:
        scene_id, values = claim.operation.scene_id, {**values, "updated_at": time.time()}
        execute_fenced(connection, claim, uncancelled(claim).values(values))
        execute_fenced(connection, claim, update(scenes).where(scenes.c.id == scene_id).values(state="TRAINING"))
        return publish_made_within(connection, scene_id, summary, carried, edited=edited, draft=draft)

    def _end(self, claim: Claim, state: str, error: Mapping[str, Any] | None) -> None:
        with self._writing() as connection:
            values = {"state": state, "error": error, "updated_at": time.time()}
            execute_fenced(connection, claim, fenced(claim).values(values))
            ended = update(scenes).where(scenes.c.id == claim.operation.scene_id, scenes.c.state == "TRAINING")
            connection.execute(ended.values(state=state))


def _requests(row: Sequence[Any]) -> frozenset[JobRequest]:
    names: tuple[JobRequest, ...] = ("cancel", "finish")
    return frozenset(name for name, requested in zip(names, row, strict=True) if requested)
