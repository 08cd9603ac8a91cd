"""Access keys of one project, managed by its admins and operators."""

from __future__ import annotations

import time
from datetime import UTC, datetime

from sqlalchemy import Connection

from fastsplat.service.application.admin.keys import Keys
from fastsplat.service.application.base.paging import read_page_token, write_page_token
from fastsplat.service.application.base.validate import check_page_size
from fastsplat.service.settings import Settings
from fastsplat.service.store.repositories.key_repository import ROLES, KeyRecord, use_key
from fastsplat.service.store.repositories.scene_repository import no_operation
from fastsplat.service.store.store import Store
from fastsplat_contract.errors import ConflictError, NotFoundError, PermissionDeniedError, QuotaError
from fastsplat_contract.server.keys import UPLOAD_KEY_S, AccessKey, KeyIn, KeyList, KeyState, NewKey, Role, UploadKeyIn

MAX_KEYS = 1_000
"""Limit of valid and recent keys of a project; servers keep all in memory."""

_DAY_S = 86_400.0


class ProjectKeys:
    """Keys of one project; keys of a higher role are hidden from the caller."""

    def __init__(self, store: Store, settings: Settings) -> None:
        self._store = store
        self._settings = settings
        self._project = store.project
        self._keys = Keys(store.keys, store.projects)

    def create(self, caller_role: Role, request: KeyIn) -> NewKey:
        """Creates a key of the project; its secret is shown only here.

        Raises:
            PermissionDeniedError: the role is higher than the caller's.
            InvalidInputError: an unusable name; a key of one scene with another role than reader, or without expiry.
            NotFoundError: no such scene in the project.
            ConflictError: a key of one scene, on a server without authentication.
            QuotaError: `MAX_KEYS` is reached.
        """
        if request.role not in _up_to(caller_role):
            raise PermissionDeniedError(
                f"a key of the role {caller_role} makes no key of the role {request.role}",
                field="role",
                limit=f"{', '.join(_up_to(caller_role))}",
                hint="Ask an operator.",
            )
        if request.scene_id:
            self._store.scenes.scene(request.scene_id)
            if self._settings.auth == "off":
                raise ConflictError(
                    "this server asks nobody for a key, so that a key of one scene would hide nothing",
                    field="scene_id",
                    hint="Start it with keys (FASTSPLAT_AUTH=on).",
                )
        now = time.time()
        if self._store.keys.count(self._project, now, now - _DAY_S) >= MAX_KEYS:
            raise QuotaError(
                f"project {self._project} has all the keys that it may",
                limit=f"{MAX_KEYS} valid keys, those made in the last day included",
                hint="Revoke keys that nobody needs; tomorrow there is room again.",
            )
        record, secret = self._keys.create(
            request.name, request.role, request.lifetime_s, self._project, request.scene_id
        )
        return NewKey(as_key(record, now), secret)

    def create_for_upload(self, request: UploadKeyIn) -> NewKey:
        """Creates a key that permits one upload; raises `QuotaError` as `create`."""
        return self.create("uploader", KeyIn("one upload", "uploader", request.lifetime_s or UPLOAD_KEY_S))

    def list(self, caller_role: Role, page_size: int = 0, page_token: str = "", scene_id: str = "") -> KeyList:
        """Lists keys (of `scene_id`, if given), newest first, paged as `SceneService.list_scenes`."""
        size = check_page_size(page_size, self._settings.store)
        after = read_page_token(page_token)
        records = self._store.keys.of_project(self._project, _up_to(caller_role), size + 1, after, scene_id)
        more = len(records) > size
        token = write_page_token(records[size - 1].created_at, records[size - 1].id) if more else ""
        now = time.time()
        return KeyList(tuple(as_key(record, now) for record in records[:size]), token)

    def revoke(self, caller_role: Role, key_id: str) -> AccessKey:
        """Revokes a key within the caller's role; running calls end within seconds."""
        self._get(caller_role, key_id)
        # Revocation must work on a full disk.
        self._store.reserve.lend(lambda: self._keys.revoke(key_id))
        return as_key(self._get(caller_role, key_id), time.time())

    def begin_upload(self, key_id: str) -> None:
        """Extends an unused upload key to one day after creation; raises `ConflictError` otherwise."""
        record = self._store.keys.find(key_id)
        if record is None or record.operation_id is not None:
            raise _used()
        self._store.keys.prolong(key_id, record.created_at + _DAY_S)

    def check_made(self, key_id: str, operation_id: str) -> None:
        """Raises `NotFoundError` unless an upload key created this operation."""
        record = self._store.keys.find(key_id)
        if record is None or record.operation_id != operation_id:
            raise no_operation(operation_id)

    def _get(self, caller_role: Role, key_id: str) -> KeyRecord:
        record = self._store.keys.find(key_id)
        if record is None or record.project != self._project or record.role not in _up_to(caller_role):
            raise NotFoundError(f"no key {key_id[:80]!r}", field="key_id", hint="List the keys to see which there are.")
        return record


def check_unused(connection: Connection, key_id: str, operation_id: str) -> None:
    """Binds an upload key to an operation, inside the transaction that creates it.

    Raises `ConflictError` for a used or invalid key; the transaction must not be committed then.
    """
    if not use_key(connection, key_id, operation_id, time.time()):
        raise _used()


def _used() -> ConflictError:
    return ConflictError(
        "this key was for one upload, and has made its scene",
        field="authorization",
        hint="Make another link, or key, for another scene.",
    )


def _up_to(role: Role) -> tuple[Role, ...]:
    """Roles up to and including this one."""
    return ROLES[: ROLES.index(role) + 1]


def as_key(record: KeyRecord, now: float) -> AccessKey:
    """Converts a key record for its project's admins, without its hash."""
    state: KeyState = "VALID" if record.valid(now) else "EXPIRED" if record.revoked_at is None else "REVOKED"
    return AccessKey(
        id=record.id,
        name=record.name,
        project=record.project,
        role=record.role,
        state=state,
        created_at=_moment(record.created_at),
        expires_at=None if record.expires_at is None else _moment(record.expires_at),
        revoked_at=None if record.revoked_at is None else _moment(record.revoked_at),
        scene_id=record.scene_id,
        operation_id=record.operation_id or "",
    )


def _moment(seconds: float) -> datetime:
    return datetime.fromtimestamp(seconds, UTC)
