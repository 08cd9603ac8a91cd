"""Access keys `fsk_<id>_<secret>`: shown once, stored as hashes, compared in constant time.

The secret has 256 random bits, so plain sha256 suffices, unlike for passwords.
"""

from __future__ import annotations

import hashlib
import hmac
import os
import re
import secrets
import time
from collections.abc import Mapping, Set
from dataclasses import replace
from pathlib import Path

from fastsplat.service.common.files import sync_directory
from fastsplat.service.store.repositories.key_repository import ROLES, KeyRecord, KeyRepository
from fastsplat.service.store.repositories.project_repository import ProjectRepository
from fastsplat.service.store.rows.records import DEFAULT_PROJECT
from fastsplat_contract.errors import InvalidInputError, NotFoundError, ResourceError
from fastsplat_contract.server.keys import MAX_LIFETIME_S, Role

_KEY = re.compile(r"fsk_([0-9a-f]{12})_[A-Za-z0-9_-]{43}")
_NOBODY = "0" * 64
_MAX_NAME = 200


class Keys:
    """The keys of one database."""

    def __init__(self, rows: KeyRepository, projects: ProjectRepository) -> None:
        self._rows = rows
        self._projects = projects

    def create(
        self, name: str, role: Role, lifetime_s: float | None = None, project: str = DEFAULT_PROJECT, scene_id: str = ""
    ) -> tuple[KeyRecord, str]:
        """Creates a key; returns its record and the key, which is not stored.

        Args:
            scene_id: restricts the key to one scene; such a key is a reader's and expires.

        Raises:
            InvalidInputError: an unusable name, role or lifetime.
            NotFoundError: no such project.
        """
        if not 0 < len(name) <= _MAX_NAME or not name.isprintable():
            raise InvalidInputError("the name is empty, too long or not printable", field="name")
        if role not in ROLES:
            raise InvalidInputError(f"no role {str(role)[:80]!r}", field="role", hint=f"There are {', '.join(ROLES)}.")
        if lifetime_s is not None and not 0 < lifetime_s <= MAX_LIFETIME_S:
            raise InvalidInputError(
                f"a lifetime of {lifetime_s} s", field="lifetime_s", limit=f"above 0, to {MAX_LIFETIME_S:.0f} s"
            )
        if scene_id and (role != "reader" or lifetime_s is None):
            raise InvalidInputError(
                "a key of one scene looks only, and expires",
                field="role" if role != "reader" else "lifetime_s",
                hint='Send the role "reader" and a lifetime.',
            )
        if not self._projects.exists(project):
            raise NotFoundError(
                f"no project {project[:80]!r}",
                field="project",
                hint="Make it with: fastsplat projects create NAME; or see which there are: fastsplat projects list",
            )
        key = _new_key()
        record = replace(_record(key, name, role, lifetime_s, project), scene_id=scene_id)
        self._rows.add(record)
        return record, key

    def all(self) -> tuple[KeyRecord, ...]:
        """Every key ever created, oldest first."""
        return tuple(self._rows.all())

    def revoke(self, key_id: str) -> None:
        """Revokes a key; `NotFoundError` if there is none of that id."""
        self._rows.revoke(key_id, time.time())

    def valid(self) -> KeyRing:
        """The currently valid keys."""
        now = time.time()
        by_id = {record.id: record for record in self._rows.valid(now)}
        return KeyRing(by_id, frozenset(self._projects.names()))

    def ensure_first(self, path: Path) -> bool:
        """Creates an operator key in `path` (mode 0600) if no key was ever created.

        Concurrent processes agree on one key. Returns whether the file holds a new key; raises `ResourceError` on
        failure.
        """
        if self._rows.all():
            return False
        try:
            key = _shared_secret(path)
        except OSError as error:
            raise ResourceError(
                f"the first key cannot be written to {path}: {error.strerror}",
                field="data_dir",
                hint="Make the data folder writable, or make a key with: fastsplat keys create",
            ) from error
        self._rows.add(_record(key, "first", "operator", None, DEFAULT_PROJECT))
        return True


class KeyRing:
    """Valid keys in memory, checked without database access."""

    def __init__(self, by_id: Mapping[str, KeyRecord], projects: Set[str] = frozenset()) -> None:
        self._by_id = by_id
        self.projects = projects
        """All project names."""

    def __contains__(self, key_id: object) -> bool:
        return key_id in self._by_id

    def is_valid(self, key_id: str) -> bool:
        record = self._by_id.get(key_id)
        return record is not None and record.valid(time.time())

    def find(self, key: str) -> KeyRecord | None:
        """Record of a currently valid key; the secret is compared in constant time."""
        match = _KEY.fullmatch(key)
        record = self._by_id.get(match[1]) if match else None
        same = hmac.compare_digest(_hash(key), record.hash if record else _NOBODY)
        return record if record is not None and same and record.valid(time.time()) else None


def key_id_of(key: str) -> str:
    """Id inside a key; "" if malformed."""
    match = _KEY.fullmatch(key)
    return match[1] if match else ""


def _new_key() -> str:
    return f"fsk_{secrets.token_hex(6)}_{secrets.token_urlsafe(32)}"


def _hash(key: str) -> str:
    return hashlib.sha256(key.encode(errors="replace")).hexdigest()


def _record(key: str, name: str, role: Role, lifetime_s: float | None, project: str) -> KeyRecord:
    now = time.time()
    expires_at = None if lifetime_s is None else now + lifetime_s
    return KeyRecord(key_id_of(key), name, role, _hash(key), now, expires_at, project=project)


def _shared_secret(path: Path) -> str:
    """Key in `path`; the first process writes it atomically."""
    partial = path.with_name(f".{path.name}.{secrets.token_hex(6)}")
    handle = os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    try:
        with os.fdopen(handle, "w") as file:
            file.write(_new_key() + "\n")
            file.flush()
            os.fsync(file.fileno())
        try:
            os.link(partial, path)
            sync_directory(path.parent)
        except FileExistsError:
            pass
    finally:
        partial.unlink()
    key = path.read_text().strip()
    if not key_id_of(key):
        raise ResourceError(f"{path} holds no key", field="data_dir", hint="Remove the file, then start again.")
    return key
