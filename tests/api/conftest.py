"""One service with one made scene behind both faces; a scene of its own for each test that changes it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.settings import Settings
from fastsplat_client import Client
from tests.api.clients import client_of
from tests.api.guarded import Guarded, guarded_server
from tests.api.made_scene import ENCODER, add_scene, write_words
from tests.api.pem import write_pem
from tests.api.served import Faces, on_free_ports, served
from tests.api.upright_scene import add_upright_scene
from tests.color_segmenter import ADAPTER, write_color_segmenter

MAX_UPLOAD_BYTES = 3_000_000


@pytest.fixture(scope="session")
def api_settings(tmp_path_factory: pytest.TempPathFactory) -> Settings:
    """Free ports, small limits, a words table for an encoder."""
    folder: Path = tmp_path_factory.mktemp("api")
    write_words(folder / "models")
    write_color_segmenter(folder / "models")
    return on_free_ports(
        data_dir=folder / "data",
        models=folder / "models",
        perception=PerceptionSettings(
            text_encoder=ENCODER, open_set_detector="grounding_dino_tiny", segmenter=ADAPTER
        ),  # never opened: nothing is trained
        capture=CaptureSettings(max_upload_bytes=MAX_UPLOAD_BYTES),
        query=QuerySettings(backend="cpu", threshold=0.5, exact_threshold=0.95),
    )


@pytest.fixture(scope="session")
def service(api_settings: Settings) -> Iterator[SceneService]:
    with open_service(api_settings) as opened:
        yield opened


@pytest.fixture(scope="session")
def scene_id(service: SceneService, api_settings: Settings) -> str:
    return add_scene(service, api_settings)


@pytest.fixture(scope="session")
def upright_id(service: SceneService, api_settings: Settings) -> str:
    """The scene whose z axis is up."""
    return add_upright_scene(service, api_settings)


@pytest.fixture(scope="session")
def faces(service: SceneService, api_settings: Settings) -> Iterator[Faces]:
    """REST and gRPC over the same service."""
    with served(service, api_settings) as running:
        yield running


@pytest.fixture(scope="session")
def guarded(api_settings: Settings, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Guarded]:
    """A server that asks for keys, with a key of every kind."""
    with guarded_server(api_settings, tmp_path_factory.mktemp("guarded")) as running:
        yield running


@pytest.fixture
def client(faces: Faces) -> Iterator[Client]:
    with client_of(faces) as opened:
        yield opened


@pytest.fixture
def fresh_id(service: SceneService, api_settings: Settings) -> Iterator[str]:
    """A made scene that the test may change."""
    scene_id = add_scene(service, api_settings, "to change")
    yield scene_id
    service.delete_scene(scene_id)


@pytest.fixture(scope="session")
def pem(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pem")
    write_pem(folder)
    return folder
