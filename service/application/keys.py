"""Access keys: made once, shown once, kept as hashes, found in constant time.

A key is `fsk_<id>_<secret>`; the secret has 256 random bits, so a plain sha256 is as good at rest as a slow hash is for
passwords.
"""

from __future__ import annotations

import hashlib
import hmac
import os
import re
import secrets
import time
from collections.abc import Mapping
from pathlib import Path

from fastsplat.service.store.blobs import sync_folder
from fastsplat.service.store.key_repository import KeyKind, KeyRecord, KeyRepository
from fastsplat_contract.errors import InvalidInputError, ResourceError

_KEY = re.compile(r"fsk_([0-9a-f]{12})_[A-Za-z0-9_-]{43}")
_NOBODY = "0" * 64
_MAX_NAME = 200


class Keys:
    """The keys of one database."""

    def __init__(self, rows: KeyRepository) -> None:
        self._rows = rows

    def create(self, name: str, kind: KeyKind, lifetime_s: float | None = None) -> tuple[KeyRecord, str]:
        """Make a key. Returns its record, and the key itself, which nobody can tell again.

        Args:
            name: for people.
            kind: "write", or "read" for one that can only ask and look.
            lifetime_s: seconds until it expires; None: never.

        Raises:
            InvalidInputError: an unusable name or lifetime.
        """
        if not 0 < len(name) <= _MAX_NAME or not name.isprintable():
            raise InvalidInputError("the name is empty, too long or not printable", field="name")
        if lifetime_s is not None and not 0 < lifetime_s < 1e10:
            raise InvalidInputError(f"a lifetime of {lifetime_s} s", field="expires", hint="Give a time above 0.")
        key = _new_key()
        record = _record(key, name, kind, lifetime_s)
        self._rows.add(record)
        return record, key

    def all(self) -> tuple[KeyRecord, ...]:
        """Every key ever made, oldest first."""
        return tuple(self._rows.all())

    def revoke(self, key_id: str) -> None:
        """Take a key back.

        Raises:
            NotFoundError: there is none of that id.
        """
        self._rows.revoke(key_id, time.time())

    def valid(self) -> KeyRing:
        """The keys that open something now."""
        now = time.time()
        return KeyRing({record.id: record for record in self._rows.all() if record.valid(now)})

    def ensure_first(self, path: Path) -> bool:
        """If no key was ever made, make one that may write and leave it in the file `path` (mode 0600).

        Any number of processes may do this at once: they agree on one key. Returns whether the file holds a new key.

        Raises:
            ResourceError: the file cannot be written.
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
        self._rows.add(_record(key, "first", "write", None))
        return True


class KeyRing:
    """What is needed to judge a key without a look into the database."""

    def __init__(self, by_id: Mapping[str, KeyRecord]) -> None:
        self._by_id = by_id

    def __contains__(self, key_id: object) -> bool:
        return key_id in self._by_id

    def find(self, key: str) -> KeyRecord | None:
        """The record of a key that is valid now. Takes as long for a wrong secret as for the right one."""
        match = _KEY.fullmatch(key)
        record = self._by_id.get(match[1]) if match else None
        same = hmac.compare_digest(_hash(key), record.hash if record else _NOBODY)
        return record if record is not None and same and record.valid(time.time()) else None


def key_id_of(key: str) -> str:
    """The id inside a key; "" if it has not the shape of one."""
    match = _KEY.fullmatch(key)
    return match[1] if match else ""


def _new_key() -> str:
    return f"fsk_{secrets.token_hex(6)}_{secrets.token_urlsafe(32)}"


def _hash(key: str) -> str:
    return hashlib.sha256(key.encode(errors="replace")).hexdigest()


def _record(key: str, name: str, kind: KeyKind, lifetime_s: float | None) -> KeyRecord:
    now = time.time()
    return KeyRecord(key_id_of(key), name, kind, _hash(key), now, None if lifetime_s is None else now + lifetime_s)


def _shared_secret(path: Path) -> str:
    """The key in `path`; whoever is first writes it, whole or not at all."""
    partial = path.with_name(f".{path.name}.{secrets.token_hex(6)}")
    handle = os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    try:
        with os.fdopen(handle, "w") as file:
            file.write(_new_key() + "\n")
            file.flush()
            os.fsync(file.fileno())
        try:
            os.link(partial, path)
            sync_folder(path.parent)
        except FileExistsError:
            pass
    finally:
        partial.unlink()
    key = path.read_text().strip()
    if not key_id_of(key):
        raise ResourceError(f"{path} holds no key", field="data_dir", hint="Remove the file, then start again.")
    return key
