"""A data folder whose service and command line read the same settings."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from fastsplat.cli.main import app
from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.settings import load_settings
from tests.api.made_scene import ENCODER, write_words


@contextmanager
def configured(folder: Path) -> Iterator[None]:
    """The settings of this process are those of `folder / "data"`, with a drawn text encoder."""
    write_words(folder / "models")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FASTSPLAT_DATA_DIR", str(folder / "data"))
        patch.setenv("FASTSPLAT_MODELS", str(folder / "models"))
        patch.setenv("FASTSPLAT_PERCEPTION__TEXT_ENCODER", ENCODER)
        load_settings.cache_clear()
        yield
    load_settings.cache_clear()


@pytest.fixture
def service(tmp_path: Path) -> Iterator[SceneService]:
    """The service of `tmp_path / "data"`; commands of this process use the same."""
    with configured(tmp_path), open_service(load_settings()) as opened:
        yield opened


@pytest.fixture
def fastsplat() -> Callable[..., Result]:
    """A command, by its words."""
    return lambda *words: CliRunner().invoke(app, [str(word) for word in words])
