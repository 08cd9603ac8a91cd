"""A server with a scene behind the page that `make page` built, and a browser."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest
from playwright.sync_api import Browser

from fastsplat.api.rest.page import BUILT_PAGE
from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.capture.settings import CaptureSettings
from fastsplat.service.perception.settings import PerceptionSettings
from fastsplat.service.query.settings import QuerySettings
from fastsplat.service.settings import Settings
from tests.api.made_scene import ENCODER, write_words
from tests.api.served import serving
from tests.web.browser import chromium
from tests.web.table import add_table

MARKUP = "<b onclick=alert(1)>violin</b><script>alert(2)</script>"
"""A name that the text encoder knows, and that no page may take for markup."""


@dataclass(frozen=True)
class Place:
    """A running server.

    Attributes:
        url: of its page, without a slash at its end.
        service: the service layer below.
        settings: its settings.
        scene_id: a scene that every test may read.
    """

    url: str
    service: SceneService
    settings: Settings
    scene_id: str

    def new_scene(self, name: str = "a table") -> str:
        """A scene of a test's own."""
        return add_table(self.service, self.settings, name)


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """The browser, for the tests of a file: while it runs, Playwright holds the thread's event loop, and tests of other
    rooms that follow in the same process want one of their own."""
    if not (BUILT_PAGE / "index.html").is_file():
        pytest.skip("the page is not built: make page")
    with chromium() as running:
        yield running


def page_settings(folder: Path, **more: object) -> Settings:
    """Settings of a server that only the page's tests ask."""
    write_words(folder / "models", MARKUP)
    settings = Settings(
        data_dir=folder / "data",
        models=folder / "models",
        http_port=0,
        grpc_port=0,
        metrics_port=0,
        auth="off",
        perception=PerceptionSettings(text_encoder=ENCODER, open_set_detector="any"),  # never opened
        capture=CaptureSettings(max_upload_bytes=30_000_000),
        query=QuerySettings(backend="cpu", threshold=0.5, exact_threshold=0.95),
    )
    return settings.model_copy(update=more)


@contextmanager
def place_with(settings: Settings) -> Iterator[Place]:
    """A server of these settings, without keys, and a scene."""
    with open_service(settings) as service, serving(service, settings) as ports:
        yield Place(f"http://127.0.0.1:{ports.http}", service, settings, add_table(service, settings))


@pytest.fixture(scope="module")
def place(browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Place]:
    """A server without keys and a scene."""
    with place_with(page_settings(tmp_path_factory.mktemp("web"))) as running:
        yield running


@pytest.fixture
def own(place: Place) -> Iterator[str]:
    """A scene of one test."""
    scene_id = place.new_scene("own")
    yield scene_id
    place.service.delete_scene(scene_id)
