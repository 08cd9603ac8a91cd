"""The scene as one file, opened from disk without its server."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from playwright.sync_api import Browser, expect

from fastsplat_contract.messages.exports import ExportRequest
from fastsplat_contract.messages.queries import QueryRequest
from tests.api.made_scene import LABELS
from tests.web.browser import TOUCH_PHONE, Visit, visiting
from tests.web.glow import canvas_pixels, glowing, overlap, page_camera, server_mask
from tests.web.objects.test_ask import _VIEW
from tests.web.places import MARKUP, Place
from tests.web.table import add_table


@contextmanager
def _opened(browser: Browser, file: Path, fragment: str = "", **options: Any) -> Iterator[Visit]:
    """The file in a browser of its own that is offline; it may ask for nothing but itself."""
    alone = {"offline": True, "device_scale_factor": 1, **options}
    with visiting(browser, file.parent.as_uri(), f"{file.name}{fragment}", **alone) as visit:
        yield visit
        urls = {url.partition("#")[0] for url in visit.requests if not url.startswith(("blob:", "data:"))}
        assert urls == {file.as_uri()}


def _written(place: Place, folder: Path, scene_id: str = "") -> Path:
    file = folder / "scene.html"
    file.write_bytes(place.service.exports.file(ExportRequest(scene_id or place.scene_id, "html")))
    return file


def test_what_glows_in_the_file_is_the_servers_mask(place: Place, webgl_browser: Browser, tmp_path: Path) -> None:
    file = _written(place, tmp_path)
    with _opened(webgl_browser, file, f"#?view={_VIEW}") as visit:
        visit.shows("plain")
        plain = canvas_pixels(visit.page)
    with _opened(webgl_browser, file, f"#?view={_VIEW}&q=mugs") as visit:
        visit.shows("answer")
        glow_mask = glowing(plain, canvas_pixels(visit.page))
        height, width = glow_mask.shape
        mask = server_mask(place, page_camera(visit.page, width, height), "mug")
        assert mask.sum() > 2_000 and overlap(mask, glow_mask) >= 0.9


def test_the_file_answers_its_own_names_as_the_server_does(
    place: Place, webgl_browser: Browser, tmp_path: Path
) -> None:
    with _opened(webgl_browser, _written(place, tmp_path)) as visit:
        visit.shows("plain")
        visit.check_accessible()
        before = canvas_pixels(visit.page)
        for question, label in (("Where are the mugs?", "mug"), ("story book", "story book")):
            visit.page.get_by_role("searchbox").fill(question)
            visit.page.get_by_role("button", name="Ask", exact=True).click()
            expect(visit.page.locator(".verdict.here")).to_be_visible()
            (answer,) = place.service.answers.query(QueryRequest(place.scene_id, (label,))).answers
            assert answer.outcome == "here"
            expect(visit.page.get_by_text(answer.sentence)).to_be_visible()
            expect(visit.page.get_by_role("button", name=f"Look at {label} 1")).to_be_visible()
            visit.shows("answer")
            now = canvas_pixels(visit.page)
            assert (now != before).mean() > 0.1  # it has flown there, and something else glows
            before = now
        visit.check_accessible()

        visit.page.get_by_role("searchbox").fill("submarine")
        visit.page.keyboard.press("Enter")
        expect(visit.page.get_by_text("Not answerable offline")).to_be_visible()
        expect(visit.page.get_by_text("Not here")).not_to_be_visible()
        visit.shows("plain")
        visit.page.get_by_role("button", name="ball", exact=True).click()
        visit.shows("answer")


def test_markup_in_names_stays_text(place: Place, webgl_browser: Browser, tmp_path: Path) -> None:
    hostile = "</script><img src=x onerror=document.title=1><!--<script>"
    scene_id = add_table(place.service, place.settings, hostile, (MARKUP, *LABELS[1:]))
    file = _written(place, tmp_path, scene_id)
    with _opened(webgl_browser, file) as visit:
        visit.shows("plain")
        expect(visit.page.get_by_role("heading", level=1)).to_have_text(hostile)
        visit.page.get_by_role("button", name=MARKUP).click()
        expect(visit.page.locator(".verdict.here")).to_be_visible()
        visit.shows("answer")
        assert visit.page.title() == hostile and visit.page.locator("img, b").count() == 0
    text = file.read_text()
    data = text.partition('<script type="application/json" id="scene">')[2].partition("</script>")[0]
    assert "<" not in data and json.loads(data)["name"] == hostile


def test_the_file_is_small_and_asks_nobody(place: Place, webgl_browser: Browser, tmp_path: Path) -> None:
    file = _written(place, tmp_path)
    assert file.stat().st_size < 3_000_000
    text = file.read_text()
    assert re.search(r'http-equiv="Content-Security-Policy" content="default-src \'none\'; script-src \'sha256-', text)
    assert not re.search(r"""<(?:link|script|img|iframe)[^>]+(?:href|src)=""", text.partition("<style>")[0])
    assert re.search(r"^playcanvas \S+ \(MIT\)$", text, re.MULTILINE)
    with _opened(webgl_browser, file, "#?q=ball", **TOUCH_PHONE, color_scheme="dark") as visit:
        visit.shows("answer")
        assert visit.fits()
        visit.check_accessible()
        visit.page.locator("canvas").focus()
        before = canvas_pixels(visit.page)
        visit.page.keyboard.press("ArrowLeft")
        assert (canvas_pixels(visit.page) != before).any()
