"""`fastsplat status`: what the server can do, as JSON."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from fastsplat.cli.main import app
from fastsplat.service.settings import load_settings


def test_the_status_of_this_machines_data_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FASTSPLAT_DATA_DIR", str(tmp_path / "data"))
    monkeypatch.setenv("FASTSPLAT_MODELS", str(tmp_path / "models"))
    monkeypatch.setenv("FASTSPLAT_QUOTAS__SCENES", "3")
    load_settings.cache_clear()
    told = json.loads(CliRunner().invoke(app, ["status"]).stdout)
    load_settings.cache_clear()
    assert (told["role"], told["project"], told["workers"]) == ("operator", "default", 0)
    assert told["quotas"][0] == {"kind": "scenes", "used": 0, "limit": 3}
    assert {model["role"]: model["state"] for model in told["models"]}["text_encoder"] == "missing"
