"""A question on the page: what it says, and how the camera moves. What glows: `test_glow.py`."""

from __future__ import annotations

import re
from datetime import datetime, timedelta
from typing import Literal
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray
from playwright.sync_api import Browser, expect

from tests.api.proxy import proxied
from tests.web.browser import TOUCH_PHONE, visiting
from tests.web.glow import page_view
from tests.web.places import Place

_VIEW = "0.9_-2.6_1.9_0_0_0.2"  # of the tests' own: position and target
_OTHER_SIDE = "-0.9_2.6_1.9_0_0_0.2"


def test_a_text_is_answered_as_typing_stops(place: Place, webgl_browser: Browser) -> None:
    with visiting(webgl_browser, place.url, f"#/scenes/{place.scene_id}") as visit:
        visit.scene_shown()
        before = visit.page.url
        clock = visit.page.clock  # of its own, so that keys on a slow machine are not pauses
        clock.install()
        clock.pause_at(datetime.now() + timedelta(seconds=1))
        for key in "mug":
            clock.run_for(300)
            visit.page.get_by_role("searchbox").press(key)
        clock.run_for(400)
        clock.resume()
        expect(visit.page.locator(".verdict.here")).to_be_visible()
        visit.shows("answer")
        expect(visit.page.get_by_role("button", name="Look at mug 1")).to_be_visible()
        expect(visit.page.get_by_role("button", name="Ask for story book")).to_be_visible()
        expect(visit.page).to_have_url(re.compile(r"q=mug.*view="))
        assert visit.page.url != before  # the camera has flown there
        assert len([url for url in visit.requests if url.endswith(":query")]) == 1
        visit.check_accessible()

        visit.page.get_by_role("searchbox").fill("submarine")
        expect(visit.page.get_by_text(re.compile("^Not here"))).to_be_visible()
        visit.shows("plain")
        visit.check_accessible()


def test_left_is_as_the_page_shows_it(place: Place, browser: Browser) -> None:
    """By the sentence, which the server made, and from the other side the other object."""
    question = "the object left of the ball"
    said = []
    for view in (_VIEW, _OTHER_SIDE):
        with visiting(browser, place.url, f"#/scenes/{place.scene_id}?q={quote(question)}&view={view}") as visit:
            sentence = visit.page.locator(".verdict")
            expect(sentence).to_contain_text("left of the ball.")
            said.append(sentence.inner_text())
            visit.shows("answer")
            visit.check_accessible()
    assert len(said) == len(set(said)) == 2


def test_the_camera_moves_by_keyboard_and_comes_home(place: Place, browser: Browser) -> None:
    with visiting(browser, place.url, f"#/scenes/{place.scene_id}") as visit:
        visit.shows("plain")
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


def test_the_camera_moves_by_mouse(place: Place, webgl_browser: Browser) -> None:
    with visiting(webgl_browser, place.url, f"#/scenes/{place.scene_id}?view={_VIEW}") as visit:
        visit.scene_shown()
        mouse = visit.page.mouse
        distance = np.linalg.norm(page_view(visit.page)[:3] - page_view(visit.page)[3:])

        def dragged(button: Literal["left", "right"]) -> NDArray[np.float64]:
            before = visit.page.url
            mouse.move(300, 300)
            mouse.down(button=button)
            mouse.move(360, 330, steps=4)
            mouse.up(button=button)
            expect(visit.page).not_to_have_url(before)
            visit.at_rest()  # a slow machine may note the address in the middle of the way, too
            return page_view(visit.page)

        start = page_view(visit.page)
        orbited = dragged("left")
        np.testing.assert_allclose(orbited[3:], start[3:], atol=1e-5)
        assert np.linalg.norm(orbited[:3] - start[:3]) > 0.1
        np.testing.assert_allclose(np.linalg.norm(orbited[:3] - orbited[3:]), distance, rtol=1e-4)
        moved = dragged("right")
        np.testing.assert_allclose(moved[:3] - moved[3:], orbited[:3] - orbited[3:], atol=1e-4)
        assert np.linalg.norm(moved[3:] - orbited[3:]) > 0.1
        before = visit.page.url
        mouse.wheel(0, -200)
        expect(visit.page).not_to_have_url(before)
        zoomed = page_view(visit.page)
        assert np.linalg.norm(zoomed[:3] - zoomed[3:]) < 0.9 * distance


def test_the_camera_moves_by_touch(place: Place, browser: Browser) -> None:
    with visiting(browser, place.url, f"#/scenes/{place.scene_id}?view={_VIEW}", **TOUCH_PHONE) as visit:
        visit.shows("plain")
        start, session = page_view(visit.page), visit.page.context.new_cdp_session(visit.page)

        def touch(kind: str, *places: tuple[int, int]) -> None:
            points = [{"x": x, "y": y, "id": number} for number, (x, y) in enumerate(places)]
            session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

        touch("touchStart", (150, 300), (250, 300))
        for step in range(1, 6):
            touch("touchMove", (150 - 10 * step, 300), (250 + 10 * step, 300))
        touch("touchEnd")
        expect(visit.page).not_to_have_url(re.compile(_VIEW))
        visit.at_rest()
        pinched = page_view(visit.page)
        ratio = np.linalg.norm(pinched[:3] - pinched[3:]) / np.linalg.norm(start[:3] - start[3:])
        assert 0.4 < ratio < 0.65  # the fingers are twice as far apart


def test_markup_in_a_question_stays_text(place: Place, browser: Browser) -> None:
    text = "<img src=x onerror=document.title=1>"
    with visiting(browser, place.url, f"#/scenes/{place.scene_id}") as visit:
        visit.expected.append("400")
        visit.page.get_by_role("searchbox").fill(text)
        expect(visit.page.get_by_role("alert")).to_contain_text(text)  # this scene's encoder knows a few words only
        assert visit.page.title() == "FAST-Splat" and visit.page.locator("img[src=x]").count() == 0


def test_the_page_works_behind_a_proxy(place: Place, webgl_browser: Browser) -> None:
    port = int(place.url.rpartition(":")[2])
    with (
        proxied(port, "/robots/splat") as url,
        visiting(webgl_browser, url, f"#/scenes/{place.scene_id}?q=mug") as visit,
    ):
        expect(visit.page.locator(".verdict.here")).to_be_visible()
        visit.shows("answer")
        assert len(visit.requests) > 8
        assert all(address.startswith((f"{url}/", "blob:")) for address in visit.requests)
