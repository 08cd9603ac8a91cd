"""`fastsplat scenes`: scenes are renamed from the command line."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from fastsplat.cli.main import app
from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.settings import load_settings
from fastsplat_contract.errors import LimitExceededError, NotFoundError
from tests.api.made_scene import ENCODER, add_scene, write_words


@pytest.fixture
def service(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[SceneService]:
    write_words(tmp_path / "models")
    monkeypatch.setenv("FASTSPLAT_DATA_DIR", str(tmp_path / "data"))
    monkeypatch.setenv("FASTSPLAT_MODELS", str(tmp_path / "models"))
    monkeypatch.setenv("FASTSPLAT_PERCEPTION__TEXT_ENCODER", ENCODER)
    load_settings.cache_clear()
    with open_service(load_settings()) as opened:
        yield opened
    load_settings.cache_clear()


@pytest.fixture
def scenes() -> Callable[..., Result]:
    return lambda *words: CliRunner().invoke(app, ["scenes", *words])


def test_a_scene_is_renamed(scenes: Callable[..., Result], service: SceneService) -> None:
    scene_id = add_scene(service, load_settings())
    assert scenes("rename", scene_id, "my desk").exit_code == 0
    assert service.get_scene(scene_id).name == "my desk"
    assert isinstance(scenes("rename", scene_id, "x" * 10_000).exception, LimitExceededError)
    assert isinstance(scenes("rename", "none", "my desk").exception, NotFoundError)
    assert isinstance(scenes("rename", scene_id, "x", "--project", "other").exception, NotFoundError)
