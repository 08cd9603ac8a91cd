"""The compose file: settings and secrets reach the containers, nothing has a default password or is unbounded."""

from __future__ import annotations

import json
import re
import socket
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml

from fastsplat.service.application.service import open_service
from fastsplat.service.settings import Settings
from fastsplat_contract.errors import DatabaseError, InvalidInputError
from tests.postgres import PostgresServer

ROOT = Path(__file__).parent.parent.parent
COMPOSE = ROOT / "docker/compose.yaml"
OURS = ("api", "worker", "worker-cuda")


@pytest.fixture(scope="module")
def compose() -> dict[str, Any]:
    document: dict[str, Any] = yaml.safe_load(COMPOSE.read_text())
    return document


def test_every_container_is_named_bounded_and_its_log_rotated(compose: dict[str, Any]) -> None:
    for name, service in compose["services"].items():
        assert re.search(r":[^:]*\d", service["image"]), name
        assert service["mem_limit"] and 0 < service["pids_limit"] <= 4096, name
        assert service["logging"]["options"].keys() == {"max-size", "max-file"}, name
    version = tomllib.loads((ROOT / "client/pyproject.toml").read_text())["project"]["version"]
    for name in (*OURS, "models"):
        assert compose["services"][name]["env_file"] == ["fastsplat.env"]
        assert compose["services"][name]["image"] == f"fastsplat/{name}:${{IMAGE_VERSION:-{version}}}"


def test_the_password_is_a_file_and_has_no_default(compose: dict[str, Any]) -> None:
    assert not re.search(r"PASSWORD\w*:?-|//[^/\s@]*:[^/\s@]*@", COMPOSE.read_text())
    path = COMPOSE.parent / compose["secrets"]["database_password"]["file"]
    for ignored in (".gitignore", ".dockerignore"):
        assert f"/{path.parent.relative_to(ROOT)}/" in (ROOT / ignored).read_text().splitlines()
    for name in (*OURS, "postgres"):
        assert compose["services"][name]["secrets"] == ["database_password"]
        files = [value for key, value in compose["services"][name]["environment"].items() if key.endswith("_FILE")]
        assert files == ["/run/secrets/database_password"]


def test_the_containers_environment_opens_the_database_with_the_password_of_the_file(
    compose: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    secret = tmp_path / "database_password"
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port = probe.getsockname()[1]
    server = PostgresServer("p@ss/word", port)
    try:
        for name, value in compose["services"]["api"]["environment"].items():
            here = value.replace("/run/secrets/database_password", str(secret))
            monkeypatch.setenv(name, here.replace("@postgres/", f"@127.0.0.1:{port}/"))
        secret.write_text("p@ss/word\n")
        settings = Settings()
        assert settings.database_password == "" and "p@ss" not in json.dumps(compose)
        with open_service(settings.model_copy(update={"data_dir": tmp_path / "data"})) as service:
            assert service.list_scenes() == ((), "")
        secret.write_text("another\n")
        with pytest.raises(DatabaseError):
            open_service(Settings(data_dir=tmp_path / "data"))
    finally:
        server.close()


def test_a_secret_that_cannot_be_read_or_is_given_twice_is_refused_and_not_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FASTSPLAT_DATABASE_URL_FILE", str(tmp_path / "none"))
    with pytest.raises(InvalidInputError) as caught:
        Settings()
    assert caught.value.field == "FASTSPLAT_DATABASE_URL_FILE" and caught.value.hint
    (tmp_path / "one").write_text("sqlite:///secret")
    monkeypatch.setenv("FASTSPLAT_DATABASE_URL_FILE", str(tmp_path / "one"))
    assert Settings().database_url == "sqlite:///secret"
    monkeypatch.setenv("FASTSPLAT_DATABASE_URL", "sqlite:///other")
    with pytest.raises(InvalidInputError) as caught:
        Settings()
    assert "secret" not in str(caught.value)
