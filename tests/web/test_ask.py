"""A question on the page: what it says, and what glows."""

from __future__ import annotations

import io
import re
from urllib.parse import parse_qs

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from playwright.sync_api import Browser, Page, expect

from fastsplat_contract.camera import Camera, PosedCamera
from fastsplat_contract.queries import QueryRequest
from tests.api.proxy import proxied
from tests.web.browser import Visit, visiting
from tests.web.conftest import Place
from tests.web.table import looking

# As the page has them: api/web/src/viewer/splatView.ts and poses.ts.
_FOUND = np.array([1.0, 0.56, 0.06])
_STRENGTH, _DIMMED = 0.75, 0.45
_GLOWS = 0.4  # of a pixel; not a half, as the page's engine draws the rim of a Gaussian fainter than the server does
_FIELD_OF_VIEW = np.radians(55.0)
_VIEW = "0.9_-2.6_1.9_0_0_0.2"  # of the tests' own: position and target


def _canvas(page: Page) -> NDArray[np.float64]:
    """The 3D picture that is shown, [H, W, 3] of 0..1."""
    page.wait_for_timeout(1_500)  # software WebGL draws late
    picture = Image.open(io.BytesIO(page.locator("canvas").screenshot())).convert("RGB")
    return np.asarray(picture, dtype=np.float64) / 255


def _share(plain: NDArray[np.float64], shown: NDArray[np.float64]) -> NDArray[np.float64]:
    """[H, W]: how much of a pixel glows, 0..1: what best explains what is `shown` of what was `plain` before."""
    dimmed = _DIMMED * plain
    glow = (1 - _STRENGTH) * plain + _STRENGTH * _FOUND
    way = glow - dimmed
    return np.asarray(((shown - dimmed) * way).sum(axis=2) / (way**2).sum(axis=2))


def _camera(page: Page, width: int, height: int) -> PosedCamera:
    """Where the page looks from, read from its address."""
    view = parse_qs(page.url.partition("?")[2])["view"][0]
    numbers = np.array([float(number) for number in view.split("_")])
    focal = max(width, height) / 2 / np.tan(_FIELD_OF_VIEW / 2)
    return looking(numbers[:3], numbers[3:], Camera(width, height, focal, focal, width / 2, height / 2))


def _wait_for(visit: Visit, what: str) -> None:
    expect(visit.page.locator("canvas")).to_have_attribute("data-shown", re.compile(what))


def _without_tools(visit: Visit) -> None:
    """Takes away what lies over the picture."""
    visit.page.evaluate("document.querySelector('.viewer-tools').remove()")


def test_the_pixels_that_glow_are_the_servers_mask(place: Place, browser: Browser) -> None:
    with visiting(browser, place.url, f"#/scenes/{place.scene_id}?view={_VIEW}") as visit:
        _wait_for(visit, "plain$")
        _without_tools(visit)
        plain = _canvas(visit.page)
        visit.page.goto(f"{place.url}/#/scenes/{place.scene_id}?view={_VIEW}&q=mug")
        visit.page.reload()
        _wait_for(visit, "answer$")
        _without_tools(visit)
        shown = _share(plain, _canvas(visit.page)) > _GLOWS
        height, width = shown.shape
        posed = _camera(visit.page, width, height)
        (answer,) = place.service.answers.query(
            QueryRequest(place.scene_id, ("mug",), cameras=(posed,), outputs=frozenset({"mask2d"}))
        )
        mask = answer.masks[0].array()
        iou = (mask & shown).sum() / (mask | shown).sum()
        assert mask.sum() > 2_000 and iou >= 0.9, iou


def test_a_text_is_answered_as_typing_stops(place: Place, browser: Browser) -> None:
    with visiting(browser, place.url, f"#/scenes/{place.scene_id}") as visit:
        _wait_for(visit, "plain$")
        before = visit.page.url
        visit.page.get_by_role("searchbox").press_sequentially("mug", delay=20)
        expect(visit.page.get_by_text("Here it is")).to_be_visible()
        _wait_for(visit, "answer$")
        expect(visit.page.get_by_role("button", name="Look at mug 1")).to_be_visible()
        expect(visit.page.get_by_role("button", name="Ask for story book")).to_be_visible()
        expect(visit.page).to_have_url(re.compile(r"q=mug.*view="))
        assert visit.page.url != before  # the camera has flown there
        assert len([url for url in visit.requests if url.endswith(":query")]) == 1
        visit.check_accessible()

        visit.page.get_by_role("searchbox").fill("submarine")
        expect(visit.page.get_by_text("Not here")).to_be_visible()
        _wait_for(visit, "plain$")
        visit.check_accessible()


def test_an_address_with_a_question_can_be_sent(place: Place, browser: Browser) -> None:
    with visiting(browser, place.url, f"#/scenes/{place.scene_id}?q=ball&view={_VIEW}") as visit:
        expect(visit.page.get_by_role("searchbox")).to_have_value("ball")
        expect(visit.page.get_by_text("Here it is")).to_be_visible()
        visit.page.wait_for_timeout(500)
        assert f"view={_VIEW}" in visit.page.url  # nothing flies away from the view that was sent


def test_the_camera_moves_by_keyboard_and_comes_home(place: Place, browser: Browser) -> None:
    with visiting(browser, place.url, f"#/scenes/{place.scene_id}") as visit:
        _wait_for(visit, "plain$")
        visit.page.locator("canvas").focus()
        visit.page.keyboard.press("Home")
        expect(visit.page).to_have_url(re.compile("view="))
        home = before = visit.page.url
        for key in ("ArrowLeft", "ArrowUp", "Shift+ArrowRight", "w", "a", "e", "+"):
            visit.page.keyboard.press(key)
            expect(visit.page).not_to_have_url(before)
            before = visit.page.url
        visit.page.keyboard.press("Home")
        expect(visit.page).to_have_url(home)


def test_markup_in_a_question_stays_text(place: Place, browser: Browser) -> None:
    text = "<img src=x onerror=document.title=1>"
    with visiting(browser, place.url, f"#/scenes/{place.scene_id}") as visit:
        visit.expected.append("400")
        visit.page.get_by_role("searchbox").fill(text)
        expect(visit.page.get_by_role("alert")).to_contain_text(text)  # this scene's encoder knows a few words only
        assert visit.page.title() == "FAST-Splat" and visit.page.locator("img[src=x]").count() == 0


def test_a_phone_shows_scene_and_answer(place: Place, browser: Browser) -> None:
    phone = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}
    with visiting(browser, place.url, f"#/scenes/{place.scene_id}?q=mug", **phone) as visit:
        expect(visit.page.get_by_text("Here it is")).to_be_visible()
        _wait_for(visit, "answer$")
        assert visit.fits()
        visit.check_accessible()


def test_the_page_works_behind_a_proxy(place: Place, browser: Browser) -> None:
    port = int(place.url.rpartition(":")[2])
    with proxied(port, "/robots/splat") as url, visiting(browser, url, f"#/scenes/{place.scene_id}?q=mug") as visit:
        expect(visit.page.get_by_text("Here it is")).to_be_visible()
        _wait_for(visit, "answer$")
        assert len(visit.requests) > 8
        assert all(address.startswith((f"{url}/", "blob:")) for address in visit.requests)
