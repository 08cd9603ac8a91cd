"""Ten pages, in three widths, light and dark, as `looks/` has them; a missing sheet is written, and fails once."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from playwright.sync_api import Browser, Page, expect

from tests.web.browser import Visit, drawn, visiting
from tests.web.places import Place

_LOOKS = Path(__file__).parent / "looks"
_WIDTHS = ((390, 844), (768, 1024), (1280, 800))
_QUALITY = 70
_BLOCK = 8  # pixels of the sheet: what a letter or an edge does differently is little of it
_ALIKE = 24  # of 255
_CHANGED = 0.01  # of the blocks, e.g. a date, or a digit

_VIEW = "view=0_-3.2_1.6_0_0_0.2"


@dataclass(frozen=True)
class _Look:
    """A page: which server's, its address below the scene's or the server's, and what is done there."""

    place: str
    address: str
    ready: Callable[[Visit], object]


def _heading(name: str) -> Callable[[Visit], None]:
    return lambda visit: expect(visit.page.get_by_role("heading", name=name)).to_be_visible()


def _text(text: str) -> Callable[[Visit], None]:
    return lambda visit: expect(visit.page.get_by_text(text).first).to_be_visible()


def _listed(visit: Visit) -> None:
    expect(visit.page.get_by_role("link", name="a table").first).to_be_visible()


def _refused(visit: Visit) -> None:
    expect(visit.page.get_by_role("alert").first).to_contain_text("nothing")


def _answered(visit: Visit) -> None:
    visit.scene_shown()
    expect(visit.page.locator(".verdict.here")).to_be_visible()


def _object(visit: Visit) -> None:
    visit.scene_shown()
    visit.tab("Objects").get_by_role("button", name="ball").click()
    expect(visit.page.get_by_role("heading", name="ball")).to_be_visible()


def _tab(name: str) -> Callable[[Visit], None]:
    def opened(visit: Visit) -> None:
        visit.scene_shown()
        visit.tab(name)

    return opened


_SCENE = f"#/scenes/{{scene}}?{_VIEW}"
_PAGES = {
    "home": _Look("place", "", _listed),
    "home-empty": _Look("small", "", _text("No scenes yet.")),
    "new": _Look("place", "#/new", _heading("New scene")),
    "no-scene": _Look("place", "#/scenes/nothing", _refused),
    "sign-in": _Look("guarded", "", _text("This server needs an access key.")),
    "scene": _Look("place", _SCENE, Visit.scene_shown),
    "answer": _Look("place", f"{_SCENE}&q=mug", _answered),
    "object": _Look("place", _SCENE, _object),
    "photos": _Look("place", _SCENE, _tab("Photos")),
    "share": _Look("place", _SCENE, _tab("Share")),
}


def _pixels(content: bytes) -> NDArray[np.uint8]:
    return np.asarray(Image.open(io.BytesIO(content)).convert("RGB"))


def _pictures(page: Page, visit: Visit) -> Iterator[tuple[NDArray[np.uint8], NDArray[np.uint8]]]:
    """The light and the dark picture of each width."""
    for width, height in _WIDTHS:
        page.set_viewport_size({"width": width, "height": height})
        page.emulate_media(color_scheme="light")
        light = _pixels(drawn(page, None))
        assert visit.fits(), width
        page.emulate_media(color_scheme="dark")
        yield light, _pixels(drawn(page, None))


def _sheet(pictures: list[tuple[NDArray[np.uint8], NDArray[np.uint8]]]) -> NDArray[np.uint8]:
    """Light above dark, one width after the other."""
    height = max(light.shape[0] for light, _ in pictures)
    columns = [
        np.concatenate([np.pad(shot, ((0, height - len(shot)), (0, 0), (0, 0))) for shot in both]) for both in pictures
    ]
    return np.concatenate(columns, axis=1)


def _blocks(sheet: NDArray[np.uint8]) -> NDArray[np.float64]:
    height, width = (side // _BLOCK * _BLOCK for side in sheet.shape[:2])
    blocks = sheet[:height, :width].reshape(height // _BLOCK, _BLOCK, width // _BLOCK, _BLOCK, 3)
    return np.asarray(blocks.mean(axis=(1, 3)))


@pytest.mark.parametrize("name", _PAGES)
def test_a_page_looks_as_it_did(
    place: Place, small: Place, guarded: Place, browser: Browser, tmp_path: Path, name: str
) -> None:
    look = _PAGES[name]
    server = {"place": place, "small": small, "guarded": guarded}[look.place]
    with visiting(browser, server.url, look.address.format(scene=server.scene_id)) as visit:
        visit.expected += ["401", "404"]
        look.ready(visit)
        visit.page.mouse.move(0, 0)  # nothing is pointed at
        for scheme in ("light", "dark"):
            visit.page.emulate_media(color_scheme=scheme)
            visit.check_accessible()
        sheet = _sheet(list(_pictures(visit.page, visit)))
    reference = _LOOKS / f"{name}.webp"
    new = tmp_path / reference.name if reference.is_file() else reference
    Image.fromarray(sheet).save(new, "WEBP", quality=_QUALITY, method=6)
    assert new != reference, f"{reference} was not there and has been written: look at it"
    before = np.asarray(Image.open(reference).convert("RGB"))
    assert before.shape == sheet.shape
    changed = (np.abs(_blocks(before) - _blocks(sheet)) > _ALIKE).any(axis=2)
    assert changed.mean() <= _CHANGED, f"{changed.mean():.1%} of the page has changed: {new}"
