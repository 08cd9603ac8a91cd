"""`fastsplat keys` and `projects`: a key is shown once, listed without itself, and revoked."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import Result

from fastsplat.service.application.service import SceneService
from fastsplat.service.settings import load_settings
from fastsplat_contract.errors import InvalidInputError, NotFoundError
from tests.commands import invoke
from tests.scenes import queued_job

Run = Callable[..., Result]


def test_a_key_is_made_listed_and_revoked(fastsplat: Run, service: SceneService) -> None:
    run = fastsplat("keys", "create", "the robot", "--role", "reader", "--days", "2")
    key = run.stdout.strip()
    record = service.admin.keys.valid().find(key)
    assert record is not None and record.role == "reader" and record.name == "the robot"
    assert record.expires_at is not None and record.expires_at - record.created_at == 2 * 86_400
    listed = fastsplat("keys", "list").stdout
    assert record.id in listed and "the robot" in listed and key.split("_", 2)[2] not in listed
    assert fastsplat("keys", "revoke", record.id[:6]).exit_code == 0
    assert service.admin.keys.valid().find(key) is None and "REVOKED" in fastsplat("keys", "list").stdout
    assert isinstance(fastsplat("keys", "revoke", "nobody").exception, NotFoundError)


def test_a_key_of_a_project_needs_the_project(service: SceneService) -> None:
    refused = invoke("keys", "create", "kitchen robot", "--project", "kitchen")
    assert isinstance(refused.exception, NotFoundError) and refused.stdout == ""
    assert invoke("projects", "create", "kitchen").exit_code == 0
    assert isinstance(invoke("projects", "create", "Kitchen!").exception, InvalidInputError)
    run = invoke("keys", "create", "kitchen robot", "--project", "kitchen", "--role", "admin")
    record = service.admin.keys.valid().find(run.stdout.strip())
    assert record is not None and (record.project, record.role) == ("kitchen", "admin")
    assert invoke("keys", "create", "x", "--role", "write").exit_code == 2
    listed = invoke("projects", "list").stdout
    assert "kitchen" in listed and "default" in listed
    assert "kitchen robot" in invoke("keys", "list", "--project", "kitchen").stdout
    assert "kitchen robot" not in invoke("keys", "list").stdout


def test_serving_without_keys_is_refused_on_an_open_host(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FASTSPLAT_DATA_DIR", str(tmp_path / "data"))
    monkeypatch.setenv("FASTSPLAT_HOST", "0.0.0.0")
    load_settings.cache_clear()
    refused = invoke("serve", "--no-auth")
    assert isinstance(refused.exception, InvalidInputError) and refused.exception.field == "auth"
    assert not (tmp_path / "data").exists()


def test_a_link_to_a_scene_is_printed_and_its_key_shows_that_scene_alone(fastsplat: Run, service: SceneService) -> None:
    refused = fastsplat("keys", "share", "0" * 32)
    assert isinstance(refused.exception, NotFoundError) and refused.stdout == ""
    job = queued_job()
    service._store.scenes.create(job)
    run = fastsplat("keys", "share", job.scene_id, "--name", "Ada", "--days", "2", "--page", "https://x.example/splat")
    page, _, key = run.stdout.strip().partition("?share=")
    assert page == f"https://x.example/splat/#/scenes/{job.scene_id}"
    record = service.admin.keys.valid().find(key)
    assert record is not None and (record.scene_id, record.role, record.name) == (job.scene_id, "reader", "Ada")
    assert record.expires_at is not None and record.expires_at - record.created_at == pytest.approx(2 * 86_400)
    assert job.scene_id[:8] in fastsplat("keys", "list").stdout
