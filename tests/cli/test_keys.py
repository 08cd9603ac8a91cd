"""`fastsplat keys`: a key is shown once, listed without itself, and revoked."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from fastsplat.cli.main import app
from fastsplat.service.application.admin.keys import Keys
from fastsplat.service.settings import load_settings
from fastsplat.service.store.records import NewJob
from fastsplat.service.store.store import open_store
from fastsplat_contract.errors import InvalidInputError, NotFoundError


@pytest.fixture
def fastsplat(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Result]]:
    monkeypatch.setenv("FASTSPLAT_DATA_DIR", str(tmp_path / "data"))
    monkeypatch.setenv("FASTSPLAT_AUTH", "on")
    monkeypatch.setenv("FASTSPLAT_HOST", "0.0.0.0")

    def call(*words: str) -> Result:
        load_settings.cache_clear()
        return CliRunner().invoke(app, words)

    yield call
    load_settings.cache_clear()


def test_a_key_is_made_listed_and_revoked(fastsplat: Callable[..., Result], tmp_path: Path) -> None:
    made = fastsplat("keys", "create", "the robot", "--role", "reader", "--days", "2")
    key = made.stdout.strip()
    store = open_store(tmp_path / "data")
    keys = Keys(store.keys, store.projects)
    record = keys.valid().find(key)
    assert record is not None and record.role == "reader" and record.name == "the robot"
    assert record.expires_at is not None and record.expires_at - record.created_at == 2 * 86_400
    listed = fastsplat("keys", "list").stdout
    assert record.id in listed and "the robot" in listed and key.split("_", 2)[2] not in listed
    assert fastsplat("keys", "revoke", record.id).exit_code == 0
    assert keys.valid().find(key) is None
    assert isinstance(fastsplat("keys", "revoke", "nobody").exception, NotFoundError)
    store.close()


def test_a_key_of_a_project_needs_the_project(fastsplat: Callable[..., Result], tmp_path: Path) -> None:
    refused = fastsplat("keys", "create", "kitchen robot", "--project", "kitchen")
    assert isinstance(refused.exception, NotFoundError) and refused.stdout == ""
    assert fastsplat("projects", "create", "kitchen").exit_code == 0
    assert isinstance(fastsplat("projects", "create", "Kitchen!").exception, InvalidInputError)
    made = fastsplat("keys", "create", "kitchen robot", "--project", "kitchen", "--role", "admin")
    store = open_store(tmp_path / "data")
    record = Keys(store.keys, store.projects).valid().find(made.stdout.strip())
    store.close()
    assert record is not None and (record.project, record.role) == ("kitchen", "admin")
    assert fastsplat("keys", "create", "x", "--role", "write").exit_code == 2
    listed = fastsplat("projects", "list").stdout
    assert "kitchen" in listed and "default" in listed
    assert "kitchen robot" in fastsplat("keys", "list", "--project", "kitchen").stdout
    assert "kitchen robot" not in fastsplat("keys", "list").stdout


def test_serving_without_keys_is_refused_on_an_open_host(fastsplat: Callable[..., Result], tmp_path: Path) -> None:
    refused = fastsplat("serve", "--no-auth")
    assert isinstance(refused.exception, InvalidInputError) and refused.exception.field == "auth"
    assert not (tmp_path / "data").exists()


def test_a_link_to_a_scene_is_printed_and_its_key_shows_that_scene_alone(
    fastsplat: Callable[..., Result], tmp_path: Path
) -> None:
    refused = fastsplat("keys", "share", "0" * 32)
    assert isinstance(refused.exception, NotFoundError) and refused.stdout == ""
    store = open_store(tmp_path / "data")
    job = NewJob("a" * 32, "b" * 32, "a table", "", "", "c" * 32, {}, 0, "default")
    store.scenes.create(job)
    made = fastsplat("keys", "share", job.scene_id, "--name", "Ada", "--days", "2", "--page", "https://x.example/splat")
    page, _, key = made.stdout.strip().partition("?share=")
    assert page == f"https://x.example/splat/#/scenes/{job.scene_id}"
    record = Keys(store.keys, store.projects).valid().find(key)
    store.close()
    assert record is not None and (record.scene_id, record.role, record.name) == (job.scene_id, "reader", "Ada")
    assert record.expires_at is not None and record.expires_at - record.created_at == pytest.approx(2 * 86_400)
    assert job.scene_id[:8] in fastsplat("keys", "list").stdout
