"""A data folder whose service and command line read the same settings."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.settings import load_settings
from tests.api.made_scene import ENCODER, write_words


@pytest.fixture
def service(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[SceneService]:
    """The service of `tmp_path / "data"`, with a drawn text encoder; commands of this process use the same."""
    write_words(tmp_path / "models")
    monkeypatch.setenv("FASTSPLAT_DATA_DIR", str(tmp_path / "data"))
    monkeypatch.setenv("FASTSPLAT_MODELS", str(tmp_path / "models"))
    monkeypatch.setenv("FASTSPLAT_PERCEPTION__TEXT_ENCODER", ENCODER)
    monkeypatch.setenv("COLUMNS", "160")
    load_settings.cache_clear()
    with open_service(load_settings()) as opened:
        yield opened
    load_settings.cache_clear()
