"""A data folder whose service and command line read the same settings, and a server over it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from typer.testing import Result

from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.settings import load_settings
from tests.api.made_scene import ENCODER, add_scene, write_words
from tests.api.served import serving
from tests.color_segmenter import ADAPTER, write_color_segmenter
from tests.commands import invoke

FREE_PORTS = {"http_port": 0, "grpc_port": 0, "metrics_port": 0}


@contextmanager
def configured(folder: Path) -> Iterator[None]:
    """The settings of this process and its commands are those of `folder / "data"`, with drawn models."""
    write_words(folder / "models")
    write_color_segmenter(folder / "models")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FASTSPLAT_DATA_DIR", str(folder / "data"))
        patch.setenv("FASTSPLAT_MODELS", str(folder / "models"))
        patch.setenv("FASTSPLAT_PERCEPTION__TEXT_ENCODER", ENCODER)
        patch.setenv("FASTSPLAT_PERCEPTION__SEGMENTER", ADAPTER)
        patch.setenv("FASTSPLAT_AUTH", "on")
        load_settings.cache_clear()
        yield
    load_settings.cache_clear()


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SceneService]:
    """The service of a data folder; commands of this process have the same."""
    with configured(tmp_path_factory.mktemp("cli")), open_service(load_settings()) as opened:
        yield opened


@pytest.fixture(scope="module")
def fastsplat(service: SceneService) -> Iterator[Callable[..., Result]]:
    """Runs a command against a server over `service`; test_commands shows that a folder says the same."""
    settings = load_settings().model_copy(update={**FREE_PORTS, "auth": "off"})
    with serving(service, settings) as ports:
        server = ["--server", f"http://127.0.0.1:{ports.http}"]
        yield lambda *words: invoke(*map(str, words), *server)


@pytest.fixture
def objects(fastsplat: Callable[..., Result]) -> Callable[..., Result]:
    return lambda *words: fastsplat("objects", *words)


@pytest.fixture
def scene_id(service: SceneService) -> str:
    """A made scene of the test's own."""
    return add_scene(service, load_settings())
