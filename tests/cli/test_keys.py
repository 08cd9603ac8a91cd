"""`fastsplat keys`: a key is shown once, listed without itself, and revoked."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from fastsplat.cli.main import app
from fastsplat.service.application.keys import Keys
from fastsplat.service.settings import load_settings
from fastsplat.service.store import open_store
from fastsplat_contract.errors import InvalidInputError, NotFoundError


@pytest.fixture
def fastsplat(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Result]]:
    monkeypatch.setenv("FASTSPLAT_DATA_DIR", str(tmp_path / "data"))
    monkeypatch.setenv("FASTSPLAT_AUTH", "on")
    monkeypatch.setenv("FASTSPLAT_HOST", "0.0.0.0")
    monkeypatch.setenv("COLUMNS", "200")

    def call(*words: str) -> Result:
        load_settings.cache_clear()
        return CliRunner().invoke(app, words)

    yield call
    load_settings.cache_clear()


def test_a_key_is_made_listed_and_revoked(fastsplat: Callable[..., Result], tmp_path: Path) -> None:
    made = fastsplat("keys", "create", "the robot", "--read-only", "--days", "2")
    key = made.stdout.strip()
    store = open_store(tmp_path / "data")
    keys = Keys(store.keys)
    record = keys.valid().find(key)
    assert record is not None and record.kind == "read" and record.name == "the robot"
    assert record.expires_at is not None and record.expires_at - record.created_at == 2 * 86_400
    listed = fastsplat("keys", "list").stdout
    assert record.id in listed and "the robot" in listed and key.split("_", 2)[2] not in listed
    assert fastsplat("keys", "revoke", record.id).exit_code == 0
    assert keys.valid().find(key) is None
    assert isinstance(fastsplat("keys", "revoke", "nobody").exception, NotFoundError)
    store.close()


def test_serving_without_keys_is_refused_on_an_open_host(fastsplat: Callable[..., Result], tmp_path: Path) -> None:
    refused = fastsplat("serve", "--no-auth")
    assert isinstance(refused.exception, InvalidInputError) and refused.exception.field == "auth"
    assert not (tmp_path / "data").exists()
