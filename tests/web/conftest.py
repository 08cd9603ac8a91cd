"""A browser and servers behind the page that `make page` built: each once for all tests of this folder."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import pytest
from playwright.sync_api import Browser

from fastsplat.api.rest.page import BUILT_PAGE
from tests.web.browser import chromium, with_webgl
from tests.web.places import Place, guarded_settings, page_settings, running, small_settings


# Not of the session: Playwright holds the thread's event loop, and tests of other folders want one of their own.
@pytest.fixture(scope="package")
def browser() -> Iterator[Browser]:
    """The browser, without WebGL: the server draws scenes, at less cost than WebGL in software."""
    if not (BUILT_PAGE / "index.html").is_file():
        pytest.skip("the page is not built: make page")
    with chromium(webgl=False) as started:
        yield started


@pytest.fixture(scope="package")
def webgl_browser(browser: Browser) -> Iterator[Browser]:
    """A browser with WebGL, for what the page draws itself."""
    with with_webgl(browser) as second_browser:
        yield second_browser


def _as_found(place: Place) -> Iterator[Place]:
    """A server, which a test leaves with the scene that it found, and no other."""
    yield place
    for scene in place.service.list_scenes().scenes:
        if scene.id != place.scene_id:
            place.service.delete_scene(scene.id)


@pytest.fixture(scope="package")
def _place(browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Place]:
    with running(page_settings(tmp_path_factory.mktemp("place"))) as place:
        yield replace(place, scene_id=place.new_scene())


@pytest.fixture
def place(_place: Place) -> Iterator[Place]:
    """A server without keys that can do everything, and a scene."""
    yield from _as_found(_place)


@pytest.fixture(scope="package")
def _guarded(browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Place]:
    with running(guarded_settings(tmp_path_factory.mktemp("guarded"))) as place:
        yield replace(place, scene_id=place.new_scene())


@pytest.fixture
def guarded(_guarded: Place) -> Iterator[Place]:
    """A server that wants keys and says where phones reach it, and a scene."""
    yield from _as_found(_guarded)


@pytest.fixture(scope="package")
def _small(browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Place]:
    with running(small_settings(tmp_path_factory.mktemp("small"))) as place:
        yield place


@pytest.fixture
def small(_small: Place) -> Iterator[Place]:
    """A server with little room, and without a detector of names that it is told; it has no scene."""
    yield from _as_found(_small)


@pytest.fixture
def scene_id(place: Place) -> str:
    """A scene of one test."""
    return place.new_scene("own")
