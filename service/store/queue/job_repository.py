"""Updates of jobs by workers, fenced by the attempt that claimed the job."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from itertools import compress
from typing import Any, Literal, get_args

from sqlalchemy import (
    ColumnElement,
    Connection,
    Engine,
    RowMapping,
    Select,
    and_,
    delete,
    exists,
    insert,
    or_,
    select,
    update,
)

from fastsplat.service.store.queue.claims import (
    LONGEST_PAUSE_S,
    Claim,
    FencedError,
    JobQueue,
    JobRequest,
    end_attempt,
    execute_fenced,
    fenced,
    newest,
)
from fastsplat.service.store.repositories.name_repository import forget_names
from fastsplat.service.store.repositories.scene_repository import (
    as_operation,
    no_operation,
    no_upload,
    queued_row,
    record_photos,
)
from fastsplat.service.store.repositories.version_repository import (
    NewVersion,
    locked_scene,
    publish_within,
    trained_version,
    version_row,
    versions_of,
)
from fastsplat.service.store.rows.damaged_rows import each_readable
from fastsplat.service.store.rows.records import NewJob, OperationRecord, SceneSummary
from fastsplat.service.store.rows.schema import attempts, operations, resumable_uploads, scene_versions, scenes
from fastsplat_contract.errors import ConflictError, NotFoundError
from fastsplat_contract.jobs.operations import FINAL_STATES, AgainAfter

_UNFINISHED = ("QUEUED", "RUNNING")
_RETRIED = ("FAILED", "CANCELLED")
_REQUESTED = (operations.c.cancel_requested, operations.c.finish_requested)
_OF_SCENE = scenes.c.id == operations.c.scene_id
_AT_ONCE = 1_000

_ROWS = scene_versions.c


class JobRepository(JobQueue):
    """The job queue and the updates of its jobs; each method is one transaction.

    Methods that take a claim, except `release`, raise `FencedError` if it is not the newest or its operation is over.
    """

    def __init__(self, engine: Engine, now: Callable[[], float] = time.time) -> None:
        """With the clock by which resumable uploads expire."""
        super().__init__(engine)
        self._now = now

    def release(self, claim: Claim, pause_s: float | None = None) -> None:
        """Gives an unfinished job back; does nothing if fenced.

        Its start does not count. With `pause_s`, seconds for which nobody claims it, its trainer died and it counts.
        """
        why: AgainAfter = "worker_stopped" if pause_s is None else "trainer_died"
        now, starts = time.time(), operations.c.starts - int(pause_s is None)
        run_after = now + min(pause_s or 0.0, LONGEST_PAUSE_S)
        values = {"starts": starts, "worker": "", "again_after": why, "run_after": run_after, "updated_at": now}
        with self._writing() as connection:
            if connection.execute(fenced(claim).values(values)).rowcount:
                end_attempt(connection, claim.operation.id, why)

    def report(
        self,
        claim: Claim,
        stages: Sequence[Mapping[str, Any]],
        *,
        starts: int | None = None,
        progress_files: Mapping[str, Mapping[str, Any]] | None = None,
    ) -> frozenset[JobRequest]:
        """Writes progress and returns the pending requests to the job; None leaves a value unchanged.

        Args:
            claim: of the job.
            stages: one row a stage.
            starts: new count of starts, as the job made progress.
            progress_files: see `OperationRecord`.
        """
        changes = {"stages": stages, "starts": starts, "progress_files": progress_files, "updated_at": time.time()}
        values = {name: value for name, value in changes.items() if value is not None}
        with self._writing() as connection:
            execute_fenced(connection, claim, fenced(claim).values(values))
            requested = connection.execute(select(*_REQUESTED).where(operations.c.id == claim.operation.id)).one()
            return _requests(requested)

    def record_photos(self, claim: Claim, photos: Sequence[Mapping[str, Any]]) -> None:
        """Writes the photo verdicts of the job's scene, as JSON objects."""
        with self._writing() as connection:
            execute_fenced(connection, claim, fenced(claim).values(updated_at=time.time()))
            record_photos(connection, claim.operation.scene_id, photos)

    def check(self, claim: Claim) -> frozenset[JobRequest]:
        """Returns the pending requests to the job, without writing."""
        with self._reading() as connection:
            requested = connection.execute(select(*_REQUESTED).where(newest(claim))).first()
        if requested is None:
            raise FencedError(claim.operation.id)
        return _requests(requested)

    def publish_draft(
        self, claim: Claim, summary: SceneSummary, carried: Sequence[NewVersion] = (), *, edited: str = ""
    ) -> None:
        """Makes a draft the scene's current version; arguments and errors as `succeed`."""
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
        """Makes the scene READY in place of its drafts, and the operation SUCCEEDED.

        Args:
            claim: of the job.
            summary: of the result.
            carried: versions with the edits of the previous draft; the first is based on `summary.version`, each other
                one on the one before.
            edited: the edited version whose edits these are; "" for none.
            result: outcome of edits of drafts, as JSON; None for no edits.
            follow: a job on the finished scene, queued in the same transaction.

        Returns:
            Names of the removed versions, whose folders the caller removes.

        Raises:
            FencedError: also if a cancellation came first, or the scene was deleted.
            ConflictError: a draft was edited meanwhile, or the edits were undone.
        """
        with self._writing() as connection:
            removed = self._publish(connection, claim, _succeeded(result), summary, carried, edited, draft=False)
            ready = update(scenes).where(scenes.c.id == claim.operation.scene_id).values(state="READY")
            execute_fenced(connection, claim, ready)
            end_attempt(connection, claim.operation.id, None)
            if follow is not None:
                connection.execute(insert(operations).values(queued_row(follow)))
        return removed

    def succeed_with_version(self, claim: Claim, new: NewVersion | None, result: Mapping[str, Any]) -> Sequence[str]:
        """Publishes the version that an operation made, if any, and ends it as SUCCEEDED.

        Returns the names of removed versions, whose folders the caller removes.

        Raises:
            FencedError: also if a cancellation came first.
            ConflictError, NotFoundError: as `publish_within`.
        """
        with self._writing() as connection:
            done = fenced(claim, uncancelled=True).values({**_succeeded(result), "updated_at": time.time()})
            execute_fenced(connection, claim, done)
            end_attempt(connection, claim.operation.id, None)
            return publish_within(connection, new)[1] if new is not None else ()

    def fail(self, claim: Claim, error: Mapping[str, Any]) -> None:
        self._end(claim, "failed", dict(error))

    def cancelled(self, claim: Claim) -> None:
        self._end(claim, "cancelled", None)

    def retry(self, operation_id: str, ended_since: float, exclude: Sequence[str] = ()) -> OperationRecord:
        """Queues a failed or cancelled operation again; returns it, unchanged if in another state.

        Args:
            ended_since: seconds since 1970; uploads of jobs that ended before are gone.
            exclude: paths of uploaded photos to leave out, beside those of earlier retries.

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
            again = {
                "state": "QUEUED", "starts": 0, "stages": [], "error": None, "cancel_requested": False,
                "finish_requested": False, "progress_files": None, "worker": "", "run_after": 0.0,
                "again_after": record.state.lower(), "retries": record.retries + 1,
                "excluded": sorted({*record.excluded, *exclude}), "updated_at": time.time(),
            }  # fmt: skip
            connection.execute(update(operations).where(here).values(again))
            return as_operation(connection.execute(select(operations).where(here)).mappings().one())

    def over(self, run_ids: Sequence[str]) -> frozenset[str]:
        """Filters run ids to those ended or unknown; operations with unreadable rows count as running."""
        unfinished = select(operations).where(operations.c.state.not_in(FINAL_STATES))
        with self._reading() as connection:
            rows = _among(connection, unfinished, operations.c.id, {run.partition(".")[0] for run in run_ids})
        records = {record.id: record.run_id for record in each_readable(rows, as_operation)}
        unreadable = frozenset(row["id"] for row in rows) - records.keys()
        live_runs = frozenset(records.values()) | {run for run in run_ids if run.partition(".")[0] in unreadable}
        return frozenset(run_ids) - live_runs

    def delete_ended(self, before: float) -> None:
        """Deletes operations without a scene that ended before a time (seconds since 1970), and expired uploads."""
        unneeded = select(operations.c.id).where(
            operations.c.updated_at < before,
            operations.c.state.in_(FINAL_STATES),
            ~exists().where(_OF_SCENE),
        )
        with self._writing() as connection:
            for column in (attempts.c.operation_id, operations.c.id):
                connection.execute(delete(column.table).where(column.in_(unneeded)))
            connection.execute(delete(resumable_uploads).where(resumable_uploads.c.expires_at < self._now()))

    def unneeded_uploads(self, ids: Collection[str], ended_since: float) -> tuple[frozenset[str], frozenset[str]]:
        """Filters upload ids to those that operations no longer need, and those of no operation, not coming in.

        Failed or cancelled operations need theirs for a retry if they ended after `ended_since` (seconds since 1970)
        and their scene still exists.
        """
        rows = operations.c
        retried = and_(rows.state.in_(_RETRIED), rows.updated_at >= ended_since, exists().where(_OF_SCENE))
        query = select(rows.upload_id, or_(rows.state.in_(_UNFINISHED), retried).label("needed"))
        coming = select(resumable_uploads.c.id).where(resumable_uploads.c.expires_at >= self._now())
        with self._reading() as connection:
            found = _among(connection, query, rows.upload_id, ids)
            unknown = frozenset(ids) - frozenset(connection.scalars(coming))
        known = frozenset(row["upload_id"] for row in found)
        needed = frozenset(row["upload_id"] for row in found if row["needed"])
        return (unknown & known) - needed, unknown - known

    def unknown_scenes(self, scene_ids: Sequence[str]) -> frozenset[str]:
        """Filters scene ids to those without a row."""
        with self._reading() as connection:
            found = _among(connection, select(scenes.c.id), scenes.c.id, scene_ids)
        return frozenset(scene_ids).difference(row["id"] for row in found)

    def lost_scenes(self, scene_ids: Sequence[str], ended_before: float) -> tuple[frozenset[str], frozenset[str]]:
        """Splits scene ids without a row into those of ended operations and those without any.

        In neither set: scenes with an operation that is unfinished or ended after `ended_before` (seconds since 1970),
        which may be being deleted.
        """
        with self._reading() as connection:
            rest = frozenset(scene_ids) - frozenset(connection.scalars(select(scenes.c.id)))
            open_here = or_(operations.c.state.in_(_UNFINISHED), operations.c.updated_at >= ended_before).label("open")
            jobs = _among(connection, select(operations.c.scene_id, open_here), operations.c.scene_id, rest)
        known = frozenset(job["scene_id"] for job in jobs)
        return known.difference(job["scene_id"] for job in jobs if job["open"]), rest - known

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
        """Makes a job's result the scene's current version, as `succeed`."""
        scene_id, values = claim.operation.scene_id, {**values, "updated_at": time.time()}
        execute_fenced(connection, claim, fenced(claim, uncancelled=True).values(values))
        execute_fenced(connection, claim, update(scenes).where(scenes.c.id == scene_id).values(state="TRAINING"))
        scene = locked_scene(connection, scene_id, "")
        records = versions_of(connection, scene_id)
        current = records.get(scene.version)
        if (current.version if current is not None and current.edits else "") != edited:
            raise ConflictError(f"the drafts of scene {scene_id!r} were edited meanwhile", field="version")
        if scene.version and not records:
            records = {scene.version: trained_version(scene)}
            if draft:
                connection.execute(insert(scene_versions).values(version_row(records[scene.version])))
        if draft and records:  # which stay for those who look at them; request ids move to the edits made again
            connection.execute(update(scene_versions).where(_ROWS.scene_id == scene_id).values(request_id=None))
        elif records:
            connection.execute(delete(scene_versions).where(_ROWS.scene_id == scene_id))
            forget_names(connection, scene_id)
        columns: dict[str, Any] = {**vars(summary), "scaling": None, "alignment": None}
        connection.execute(update(scenes).where(scenes.c.id == scene_id).values(columns))
        if draft and records:
            row = version_row(trained_version(replace(scene, **columns)))
            number = max(record.number for record in records.values()) + 1
            connection.execute(insert(scene_versions).values({**row, "number": number, "created_at": time.time()}))
        for new in carried:
            publish_within(connection, replace(new, max_versions=None))  # no carried version is pruned
        return () if draft else sorted(records)

    def _end(self, claim: Claim, why: Literal["failed", "cancelled"], error: Mapping[str, Any] | None) -> None:
        with self._writing() as connection:
            state = why.upper()
            execute_fenced(connection, claim, fenced(claim).values(state=state, error=error, updated_at=time.time()))
            end_attempt(connection, claim.operation.id, why)
            unmade = update(scenes).where(scenes.c.id == claim.operation.scene_id, scenes.c.state == "TRAINING")
            connection.execute(unmade.values(state=state))


def _among(of: Connection, query: Select[Any], column: ColumnElement[str], values: Collection[str]) -> list[RowMapping]:
    """Reads the rows of a query that have one of the values, however many these are."""
    sought = sorted(values)
    parts = (query.where(column.in_(sought[at : at + _AT_ONCE])) for at in range(0, len(sought), _AT_ONCE))
    return [row for part in parts for row in of.execute(part).mappings()]


def _succeeded(result: Mapping[str, Any] | None) -> dict[str, Any]:
    return {"state": "SUCCEEDED", "result": None if result is None else dict(result)}


def _requests(row: Sequence[Any]) -> frozenset[JobRequest]:
    return frozenset(compress(get_args(JobRequest), row))
