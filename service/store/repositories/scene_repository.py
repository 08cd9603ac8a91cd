"""Scenes and their operations in the database."""

from __future__ import annotations

import hashlib
import json
import time
import uuid
from collections.abc import Callable, Mapping, Sequence
from typing import Any, get_args

from sqlalchemy import (
    ColumnElement,
    Connection,
    Engine,
    RowMapping,
    Select,
    Table,
    delete,
    insert,
    select,
    tuple_,
    update,
)
from sqlalchemy.exc import IntegrityError

from fastsplat.service.store.repositories.name_repository import forget_names
from fastsplat.service.store.rows.codec import options_to_json
from fastsplat.service.store.rows.damaged_rows import are_objects, first_readable, is_name, require
from fastsplat.service.store.rows.database import Repository
from fastsplat.service.store.rows.records import DEFAULT_PROJECT, NewJob, OperationRecord, SceneRecord
from fastsplat.service.store.rows.schema import QUEUED, operations, quota_usage, scene_photos, scene_versions, scenes
from fastsplat_contract.errors import ArtefactError, ConflictError, NotFoundError, NotReadyError
from fastsplat_contract.jobs.operations import OperationKind, OperationState, SceneOptions
from fastsplat_contract.messages.scenes import SceneState

_LISTED = [column for column in scenes.c if column.name != "cameras"]


class SceneRepository(Repository):
    """Scenes and operations; each method is one transaction, safe from any thread.

    All may raise `DatabaseError`; those that take a scene or operation id raise `NotFoundError` if it does not exist
    here.

    Args:
        project: limits scenes and operations to a project; None: all projects.
        scene_id: limits them to one scene; "": all scenes.
    """

    def __init__(self, engine: Engine, project: str | None = None, scene_id: str = "") -> None:
        super().__init__(engine)
        self._project = project
        self._scene_id = scene_id

    def create(
        self, job: NewJob, within: Callable[[Connection], None] = lambda connection: None
    ) -> tuple[OperationRecord, bool]:
        """Makes a scene and its queued operation, or returns that of an earlier request.

        Args:
            within: called in the transaction after both inserts; if it raises, neither is made.

        Returns:
            The operation, and True if it is new.

        Raises:
            ConflictError: the request id was used for a request with other content.
        """
        now = time.time()
        scene: dict[str, Any] = {
            "id": job.scene_id, "name": job.name, "operation_id": job.operation_id, "state": "TRAINING",
            "created_at": now, "dictionary": [], "cameras": [], "quality": {}, "project": job.project,
        }  # fmt: skip
        try:
            with self._writing() as connection:
                connection.execute(insert(operations).values(queued_row(job)))
                connection.execute(insert(scenes).values(scene))
                within(connection)
                return self._operation(connection, job.operation_id), True
        except IntegrityError as error:
            return self._earlier(error, job.request_id, job.request_digest, job.project), False

    def add_ready(
        self,
        scene: SceneRecord,
        operation: OperationRecord,
        request_id: str,
        photos: Sequence[Mapping[str, Any]],
        within: Callable[[Connection], None],
    ) -> OperationRecord:
        """Inserts a scene whose version is in place, with operation and photos; otherwise as `create`."""
        try:
            with self._writing() as connection:
                connection.execute(insert(operations).values(request_id=request_id, **vars(operation)))
                connection.execute(insert(scenes).values(**vars(scene)))
                record_photos(connection, scene.id, photos)
                within(connection)
                return operation
        except IntegrityError as error:
            return self._earlier(error, request_id, operation.request_digest, operation.project)

    def add_job(self, job: NewJob) -> OperationRecord:
        """Queues an operation on an existing scene; request ids and errors are as in `create`."""
        try:
            with self._writing() as connection:
                here = select(scenes.c.id).where(scenes.c.id == job.scene_id, *self._within(scenes))
                if connection.scalar(here) is None:
                    raise no_scene(job.scene_id)
                connection.execute(insert(operations).values(queued_row(job)))
                return self._operation(connection, job.operation_id)
        except IntegrityError as error:
            return self._earlier(error, job.request_id, job.request_digest, job.project)

    def _earlier(self, error: IntegrityError, request_id: str, digest: str, project: str) -> OperationRecord:
        if (earlier := self.find_request(request_id, digest, project)) is None:
            raise error
        return earlier

    def find_request(self, request_id: str, digest: str, project: str = DEFAULT_PROJECT) -> OperationRecord | None:
        """Returns the operation made by a request id, or None; other content raises `ConflictError`."""
        if not request_id:
            return None
        with self._reading() as connection:
            here = select(operations).where(operations.c.request_id == request_id, operations.c.project == project)
            row = requested_before(connection, here, request_id, digest, "content")
        return None if row is None else as_operation(row)

    def operation(self, operation_id: str) -> OperationRecord:
        with self._reading() as connection:
            return self._operation(connection, operation_id)

    def scene(self, scene_id: str) -> SceneRecord:
        with self._reading() as connection:
            query = select(scenes).where(scenes.c.id == scene_id, *self._within(scenes))
            row = connection.execute(query).mappings().first()
        if row is None:
            raise no_scene(scene_id)
        return SceneRecord(**row)

    def current_version(self, scene_id: str) -> tuple[SceneState, str, str]:
        """Returns state, version and operation id of a scene, without its long lists."""
        columns = scenes.c.state, scenes.c.version, scenes.c.operation_id
        query = select(*columns).where(scenes.c.id == scene_id, *self._within(scenes))
        with self._reading() as connection:
            row = connection.execute(query).first()
        if row is None:
            raise no_scene(scene_id)
        state, version, operation_id = row
        require(
            f"scene {scene_id}",
            state=state in get_args(SceneState),
            version=is_name(version) or (version == "" and state != "READY"),
        )
        return state, version, operation_id

    def list_scenes(self, limit: int, after: tuple[float, str] | None = None) -> Sequence[SceneRecord]:
        """Lists scenes after (created_at, id), newest first, without cameras and without unreadable rows."""
        query = self._newest_first(select(*_LISTED), scenes, after)
        with self._reading() as connection:
            return first_readable(connection, query, limit, lambda row: SceneRecord(**row, cameras=()))

    def list_operations(
        self, limit: int, after: tuple[float, str] | None = None, state: OperationState | None = None
    ) -> Sequence[OperationRecord]:
        """Lists operations after (created_at, id), newest first, without unreadable rows."""
        query = self._newest_first(select(operations), operations, after)
        with self._reading() as connection:
            in_state = query if state is None else query.where(operations.c.state == state)
            return first_readable(connection, in_state, limit, as_operation)

    def photos_of(self, scene_id: str) -> Sequence[Mapping[str, Any]]:
        """Returns a scene's photo verdicts, [] if there are none; does not check the scene's project."""
        query = select(scene_photos.c.photos).where(scene_photos.c.scene_id == scene_id)
        with self._reading() as connection:
            photos = connection.scalar(query)
        return [] if photos is None else read_verdicts({"scene_id": scene_id, "photos": photos})

    def ready_scene_ids(self) -> Sequence[str]:
        """Lists ids of all scenes that can be queried, drafts included, newest first."""
        query = self._newest_first(select(scenes.c.id).where(scenes.c.version != ""), scenes)
        with self._reading() as connection:
            return list(connection.scalars(query))

    def rename(self, scene_id: str, name: str, expected_name: str | None = None) -> None:
        """Renames a scene; `ConflictError` unless its name is `expected_name` (None: any) or the new one."""
        this_scene = update(scenes).where(scenes.c.id == scene_id, *self._within(scenes))
        if expected_name is not None:
            this_scene = this_scene.where(scenes.c.name.in_((expected_name, name)))
        with self._writing() as connection:
            if connection.execute(this_scene.values(name=name)).rowcount:
                return
        self.current_version(scene_id)
        raise ConflictError(
            "the scene has another name by now", field="expected_name", hint="Look at its name, then send it again."
        )

    def cancel(self, operation_id: str) -> OperationRecord:
        """Cancels an operation: at once if queued, soon if running, not if ended."""
        with self._writing() as connection:
            before = self._operation(connection, operation_id)
            _stop(connection, before.id)
            return self._operation(connection, operation_id)

    def finish(self, operation_id: str) -> OperationRecord:
        """Requests an early end of training, keeping its result; `NotReadyError` unless it trains."""
        with self._writing() as connection:
            before = self._operation(connection, operation_id)
            if before.state == "RUNNING" and before.finish_requested:
                return before
            _check_trains(before)
            running = update(operations).where(operations.c.id == operation_id, operations.c.state == "RUNNING")
            connection.execute(running.values(finish_requested=True))
            return self._operation(connection, operation_id)

    def delete_scene(self, scene_id: str) -> OperationRecord | None:
        """Deletes a scene, stops its operations and frees their request ids.

        Returns the operation that made it, whose worker cleans up while RUNNING; None if its row is unreadable.
        """
        this_scene = select(scenes.c.operation_id).where(scenes.c.id == scene_id, *self._within(scenes))
        with self._writing() as connection:
            operation_id = connection.scalar(this_scene)
            if operation_id is None:
                raise no_scene(scene_id)
            # Operations first, as in every transaction that changes both, to avoid deadlocks.
            here = operations.c.scene_id == scene_id
            for stopped in connection.scalars(select(operations.c.id).where(here)).all():
                _stop(connection, stopped)
            if not connection.execute(delete(scenes).where(scenes.c.id == scene_id)).rowcount:
                raise no_scene(scene_id)
            for column in (scene_versions.c.scene_id, quota_usage.c.scene_id):
                connection.execute(delete(column.table).where(column == scene_id))
            forget_names(connection, scene_id)
            _forget_photos(connection, scene_id)
            connection.execute(update(operations).where(here).values(request_id=None, updated_at=time.time()))
            try:
                return self._operation(connection, str(operation_id))
            except (ArtefactError, NotFoundError):
                return None

    def _newest_first(self, query: Select[Any], table: Table, after: tuple[float, str] | None = None) -> Select[Any]:
        query = query.where(*self._within(table)).order_by(table.c.created_at.desc(), table.c.id.desc())
        return query if after is None else query.where(tuple_(table.c.created_at, table.c.id) < after)

    def _within(self, table: Table) -> Sequence[ColumnElement[bool]]:
        within = () if self._project is None else (table.c.project == self._project,)
        scene = table.c.id if table is scenes else table.c.scene_id
        return (*within, scene == self._scene_id) if self._scene_id else within

    def _operation(self, connection: Connection, operation_id: str) -> OperationRecord:
        query = select(operations).where(operations.c.id == operation_id, *self._within(operations))
        row = connection.execute(query).mappings().first()
        if row is None:
            raise no_operation(operation_id)
        return as_operation(row)


def order_job(kind: OperationKind, scene_id: str, request_id: str, order: Mapping[str, Any], project: str) -> NewJob:
    """Builds the job that carries out an order on a scene.

    Args:
        request_id: idempotency key; "" for none.
        order: the request as JSON.
        project: the scene's project.
    """
    content = json.dumps({"scene": scene_id, kind: order}, sort_keys=True)
    return NewJob(
        scene_id=scene_id,
        operation_id=uuid.uuid4().hex,
        name="",
        request_id=request_id,
        request_digest=hashlib.sha256(content.encode()).hexdigest(),
        upload_id="",
        options=options_to_json(SceneOptions()),
        kind=kind,
        order=dict(order),
        project=project,
    )


def queued_row(job: NewJob) -> dict[str, Any]:
    """Builds the row of an operation queued now."""
    now, more = time.time(), ("name", "operation_id", "request_id")
    columns = {name: value for name, value in vars(job).items() if name not in more}
    of_request = {"id": job.operation_id, "request_id": job.request_id or None}
    return {**columns, **of_request, "state": "QUEUED", "stages": [], "created_at": now, "updated_at": now}


def requested_before(
    connection: Connection, rows: Select[Any], request_id: str, digest: str, content: str
) -> RowMapping | None:
    """Reads the row of a request id; raises `ConflictError` if it is of another digest, so of other `content`."""
    row = connection.execute(rows).mappings().first()
    if row is not None and row["request_digest"] != digest:
        raise ConflictError(
            f"request id {request_id!r} was used before, for other {content}",
            field="request_id",
            hint=f"Send the very same {content} again, or choose a new request id.",
        )
    return row


def no_operation(operation_id: str) -> NotFoundError:
    return NotFoundError(
        f"no operation {operation_id[:80]!r}", field="operation", hint="Use the id that posting a scene returned."
    )


def no_upload(operation_id: str) -> NotFoundError:
    """The error of a retry whose upload was removed."""
    return NotFoundError(
        f"the upload of operation {operation_id!r} is not stored any more",
        field="operation",
        hint="Post the capture again. How long uploads of failed jobs are kept: FASTSPLAT_UPLOADS__FAILED_RETENTION_S.",
    )


def no_scene(scene_id: str) -> NotFoundError:
    return NotFoundError(
        f"no scene {scene_id[:80]!r}",
        field="scene",
        hint="GET /v1/scenes lists the scenes that there are, and fastsplat jobs list those of the newest jobs.",
    )


def _stop(connection: Connection, operation_id: str) -> None:
    now = time.time()
    here = operations.c.id == operation_id
    ended = {"state": "CANCELLED", "cancel_requested": True, "updated_at": now}
    if connection.execute(update(operations).where(here, QUEUED).values(ended)).rowcount:
        connection.execute(update(scenes).where(scenes.c.operation_id == operation_id).values(state="CANCELLED"))
        return
    running = update(operations).where(here, operations.c.state == "RUNNING")
    # Of one that was put off the next worker ends it at once.
    connection.execute(running.values(cancel_requested=True, run_after=0.0, updated_at=now))


def _check_trains(operation: OperationRecord) -> None:
    if operation.state not in ("QUEUED", "RUNNING"):
        raise NotReadyError(
            f"operation {operation.id!r} is {operation.state}: there is no training to end", field="operation"
        )
    training = next((row for row in operation.stages if row["stage"] == "training"), None)
    if training is None or not training["metrics"].get("iteration"):
        raise NotReadyError(
            f"operation {operation.id!r} has not begun to train",
            field="operation",
            hint="Ask again once its stage training has steps behind it; or cancel the operation.",
        )
    if training["fraction"] >= 1:
        raise NotReadyError(
            f"the training of operation {operation.id!r} is done already", field="operation", hint="Wait for its end."
        )


def as_operation(row: RowMapping) -> OperationRecord:
    hidden = ("request_id", "worker")
    values: dict[str, Any] = {name: value for name, value in row.items() if name not in hidden}
    return OperationRecord(**values)


def record_photos(connection: Connection, scene_id: str, photos: Sequence[Mapping[str, Any]]) -> None:
    """Replaces the photo verdicts (JSON objects) of a scene; does nothing if it was deleted."""
    _forget_photos(connection, scene_id)
    if connection.scalar(select(scenes.c.id).where(scenes.c.id == scene_id)) is not None:
        connection.execute(insert(scene_photos).values(scene_id=scene_id, photos=[dict(photo) for photo in photos]))


def _forget_photos(connection: Connection, scene_id: str) -> None:
    connection.execute(delete(scene_photos).where(scene_photos.c.scene_id == scene_id))


def read_verdicts(row: Mapping[Any, Any]) -> Sequence[Mapping[str, Any]]:
    """Returns the verdicts of a row; raises `ArtefactError` if they cannot be read."""
    photos: Sequence[Mapping[str, Any]] = row["photos"]
    require(f"photos of scene {row['scene_id']}", photos=are_objects(photos, "name", "placed"))
    return photos
