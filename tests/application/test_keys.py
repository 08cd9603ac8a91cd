"""Access keys: told once, kept as hashes, judged by id, secret, time and revocation."""

from __future__ import annotations

import os
import stat
import time
from pathlib import Path

import pytest

from fastsplat.service.application.admin.keys import Keys
from fastsplat.service.store.store import Store
from fastsplat_contract.errors import InvalidInputError, NotFoundError, ResourceError
from tests.at_once import at_once


@pytest.fixture
def keys(store: Store) -> Keys:
    return Keys(store.keys, store.projects)


def test_a_key_opens_nothing_near_it_does_and_only_its_hash_is_kept(keys: Keys, store: Store) -> None:
    record, key = keys.create("robot", "reader")
    _, other_key = keys.create("other", "editor")
    ring = keys.valid()
    assert ring.find(key) == record and record.role == "reader" and record.id in ring
    stem, secret = key[:17], key.split("_", 2)[2]
    swapped = f"fsk_{record.id}_{other_key.split('_', 2)[2]}"
    near = [key[:-1], key + "x", key[:-1] + ("A" if key[-1] != "A" else "B"), swapped, secret, stem, key.upper(), ""]
    near += [f" {key}", f"{key}\n", "fsk_" + "0" * 12 + "_" + secret, "ü" * 60, "\ud800"]
    assert [text for text in near if ring.find(text) is not None] == []
    assert secret not in repr(store.keys.all()) and len(record.hash) == 64


def test_expired_and_revoked_keys_open_nothing(keys: Keys) -> None:
    _, brief = keys.create("brief", "editor", lifetime_s=0.2)
    record, key = keys.create("gone", "editor")
    ring = keys.valid()
    assert ring.find(brief) and ring.find(key)
    keys.revoke(record.id)
    keys.revoke(record.id)
    time.sleep(0.3)
    assert ring.find(brief) is None  # a ring that was read before it expired
    assert keys.valid().find(brief) is None and keys.valid().find(key) is None
    assert [record.revoked_at is not None for record in keys.all()] == [False, True]


def test_nonsense_is_refused(keys: Keys) -> None:
    for name, lifetime in (("", None), ("x" * 201, None), ("a\nb", None), ("x", 0.0), ("x", -1.0), ("x", float("nan"))):
        with pytest.raises(InvalidInputError) as refused:
            keys.create(name, "reader", lifetime)
        assert refused.value.field == ("name" if lifetime is None else "lifetime_s")
    with pytest.raises(InvalidInputError):
        keys.create("robot", "write")
    with pytest.raises(NotFoundError) as caught:
        keys.create("robot", "editor", project="nowhere")
    assert caught.value.field == "project"
    with pytest.raises(NotFoundError):
        keys.revoke("nobody")
    assert keys.all() == ()


def test_the_first_key_is_one_key_however_many_start_at_once(store: Store, tmp_path: Path) -> None:
    path = tmp_path / "data" / "key"
    keys = Keys(store.keys, store.projects)
    at_once(*[lambda: Keys(store.keys, store.projects).ensure_first(path)] * 8)
    assert len(keys.all()) == 1
    found = keys.valid().find(path.read_text().strip())
    assert found is not None and (found.role, found.project) == ("operator", "default")
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert not [name for name in os.listdir(path.parent) if name.startswith(".key")]
    assert not keys.ensure_first(path)


def test_no_first_key_is_made_where_there_was_one(keys: Keys, tmp_path: Path) -> None:
    record, _ = keys.create("operator", "editor")
    keys.revoke(record.id)
    assert not keys.ensure_first(tmp_path / "key") and not (tmp_path / "key").exists()


def test_a_first_key_that_cannot_be_left_is_not_made(keys: Keys, tmp_path: Path) -> None:
    with pytest.raises(ResourceError):
        keys.ensure_first(tmp_path / "nowhere" / "key")
    (tmp_path / "odd").write_text("no key")
    with pytest.raises(ResourceError):
        keys.ensure_first(tmp_path / "odd")
    assert keys.all() == ()
