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
from tests.web.browser import Visit
from tests.web.glow import canvas_pixels, glowing, overlap, page_camera
from tests.web.objects.test_ask import _VIEW, _wait_for
from tests.web.places import MARKUP, Place
from tests.web.table import add_table


@contextmanager
def _opened(browser: Browser, file: Path, fragment: str = "", **options: Any) -> Iterator[Visit]:
    """The file in a browser of its own that is offline; it may ask for nothing but itself."""
    context = browser.new_context(**{"viewport": {"width": 1000, "height": 700}, "reduced_motion": "reduce", **options})
    context.set_offline(True)
    try:
        visit = Visit(context.new_page())
        visit.watch()
        visit.page.goto(f"{file.as_uri()}{fragment}")
        yield visit
        visit.check(file.parent.as_uri())
        urls = {url.partition("#")[0] for url in visit.requests if not url.startswith(("blob:", "data:"))}
        assert urls == {file.as_uri()}
    finally:
        context.close()


def _written(place: Place, folder: Path, scene_id: str = "") -> Path:
    file = folder / "scene.html"
    file.write_bytes(place.service.exports.file(ExportRequest(scene_id or place.scene_id, "html")))
    return file


def test_what_glows_in_the_file_is_the_servers_mask(place: Place, webgl_browser: Browser, tmp_path: Path) -> None:
    file = _written(place, tmp_path)
    with _opened(webgl_browser, file, f"#?view={_VIEW}") as visit:
        _wait_for(visit, "plain$")
        plain = canvas_pixels(visit.page)
    with _opened(webgl_browser, file, f"#?view={_VIEW}&q=mugs") as visit:
        _wait_for(visit, "answer$")
        glow_mask = glowing(plain, canvas_pixels(visit.page))
        height, width = glow_mask.shape
        posed = page_camera(visit.page, width, height)
        (answer,) = place.service.answers.query(
            QueryRequest(place.scene_id, ("mug",), cameras=(posed,), outputs=frozenset({"mask2d"}))
        ).answers
        mask = answer.masks[0].array()
        assert mask.sum() > 2_000 and overlap(mask, glow_mask) >= 0.9


def test_the_file_answers_its_own_names_as_the_server_does(
    place: Place, webgl_browser: Browser, tmp_path: Path
) -> None:
    with _opened(webgl_browser, _written(place, tmp_path)) as visit:
        _wait_for(visit, "plain$")
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
            _wait_for(visit, "answer$")
            now = canvas_pixels(visit.page)
            assert (now != before).mean() > 0.1  # it has flown there, and something else glows
            before = now
        visit.check_accessible()

        visit.page.get_by_role("searchbox").fill("submarine")
        visit.page.keyboard.press("Enter")
        expect(visit.page.get_by_text("Not answerable offline")).to_be_visible()
        expect(visit.page.get_by_text("Not here")).not_to_be_visible()
        _wait_for(visit, "plain$")
        visit.page.get_by_role("button", name="ball", exact=True).click()
        _wait_for(visit, "answer$")


def test_markup_in_names_stays_text(place: Place, webgl_browser: Browser, tmp_path: Path) -> None:
    hostile = "</script><img src=x onerror=document.title=1><!--<script>"
    scene_id = add_table(place.service, place.settings, hostile, (MARKUP, *LABELS[1:]))
    file = _written(place, tmp_path, scene_id)
    with _opened(webgl_browser, file) as visit:
        _wait_for(visit, "plain$")
        expect(visit.page.get_by_role("heading", level=1)).to_have_text(hostile)
        visit.page.get_by_role("button", name=MARKUP).click()
        expect(visit.page.locator(".verdict.here")).to_be_visible()
        _wait_for(visit, "answer$")
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
    phone = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True, "color_scheme": "dark"}
    with _opened(webgl_browser, file, "#?q=ball", **phone) as visit:
        _wait_for(visit, "answer$")
        assert visit.fits()
        visit.check_accessible()
        visit.page.locator("canvas").focus()
        before = canvas_pixels(visit.page)
        visit.page.keyboard.press("ArrowLeft")
        assert (canvas_pixels(visit.page) != before).any()
