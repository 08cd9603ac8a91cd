"""A browser without WebGL: the server draws what the person steers, and what is found or selected glows in it."""

from __future__ import annotations

import json
import re

import numpy as np
from playwright.sync_api import Browser, Request, Route, expect

from tests.web.browser import visiting
from tests.web.glow import FOUND, canvas_pixels, overlap, page_camera, server_mask, server_pixels
from tests.web.places import Place

_VIEW = "0_-3.2_1.6_0_0_0.2"
_SERVER_DRAWS = "the server draws the scene"


def test_the_server_draws_the_view_and_says_so(place: Place, browser: Browser) -> None:
    with visiting(browser, place.url, f"#/scenes/{place.scene_id}?view={_VIEW}", device_scale_factor=1) as visit:
        page = visit.page
        assert page.evaluate("document.createElement('canvas').getContext('webgl2')") is None
        visit.shows("plain")
        assert not [url for url in visit.requests if "scene.spz" in url]  # nothing is loaded before somebody moves
        visit.scene_shown()
        expect(page.get_by_text(_SERVER_DRAWS)).to_be_visible()
        visit.check_accessible()
        picture = 255 * canvas_pixels(visit.page)
        height, width, _ = picture.shape
        exact = server_pixels(place, page_camera(page, width, height))
        assert np.abs(picture - exact).mean() < 4 and exact.mean() > 20


def test_the_scene_is_loaded_some_time_after_the_servers_one_picture(place: Place, browser: Browser) -> None:
    held: list[Route] = []
    with visiting(browser, place.url, f"#/scenes/{place.scene_id}?view={_VIEW}") as visit:
        page = visit.page
        visit.shows("plain")
        page.route("**/*:render", lambda route: held.append(route))
        with page.expect_request("**/*:render"):
            visit.reload_with_clock()
        assert not [url for url in visit.requests_within(30) if "scene.spz" in url]
        (picture,) = held
        picture.continue_()
        visit.shows("plain")
        after = visit.requests_within(20)
        assert [url for url in after if "scene.spz" in url]
        assert len(held) == 1  # objects have come meanwhile, and change nothing that it shows


def test_what_is_found_glows_where_the_servers_mask_is(place: Place, browser: Browser) -> None:
    with visiting(browser, place.url, f"#/scenes/{place.scene_id}?view={_VIEW}&q=mug", device_scale_factor=1) as visit:
        expect(visit.page.locator(".verdict.here")).to_be_visible()
        visit.shows("answer")
        picture = 255 * canvas_pixels(visit.page)
        height, width, _ = picture.shape
        posed = page_camera(visit.page, width, height)
        plain = server_pixels(place, posed)
        glow = 0.25 * plain + 0.75 * 255 * np.array(FOUND[0])
        glows = np.abs(picture - glow).sum(axis=2) < np.abs(picture - 0.45 * plain).sum(axis=2)
        mask = server_mask(place, posed, "mug")
        assert mask.sum() > 2_000 and overlap(mask, glows) >= 0.9
        visit.check_accessible()


def test_a_person_steers_with_one_request_under_way(place: Place, browser: Browser) -> None:
    sizes: list[tuple[int, int]] = []
    under_way, most = 0, 0

    def begun(request: Request) -> None:
        nonlocal under_way, most
        if request.url.endswith(":render"):
            under_way += 1
            most = max(most, under_way)
            camera = json.loads(request.post_data or "")["camera"]["intrinsics"]
            sizes.append((camera["width"], camera["height"]))

    def ended(request: Request) -> None:
        nonlocal under_way
        under_way -= request.url.endswith(":render")

    with visiting(browser, place.url, f"#/scenes/{place.scene_id}?view={_VIEW}", device_scale_factor=1) as visit:
        page = visit.page
        visit.reload_with_clock()
        page.on("request", begun)
        page.on("requestfinished", ended)
        page.on("requestfailed", ended)
        visit.shows("plain")
        before = 255 * canvas_pixels(visit.page)
        canvas = page.locator("canvas")
        canvas.focus()
        for _ in range(12):
            page.keyboard.press("ArrowLeft")
        expect(page).not_to_have_url(re.compile(_VIEW))
        visit.at_rest()
        picture = 255 * canvas_pixels(visit.page)
        assert most == 1 and len(sizes) > 1
        box = canvas.bounding_box()
        assert box is not None and sizes[-1] == (round(box["width"]), round(box["height"]))
        assert np.abs(picture - server_pixels(place, page_camera(page, *sizes[-1]))).mean() < 4
        assert np.abs(picture - before).mean() > 4
        urls = visit.requests_within(10)
        assert not [url for url in urls if url.endswith(":render")]  # nothing is drawn while nothing changes


def test_objects_are_pointed_at_and_clicked(place: Place, browser: Browser) -> None:
    with visiting(browser, place.url, f"#/scenes/{place.scene_id}?view={_VIEW}") as visit:
        page, canvas = visit.page, visit.page.locator("canvas")
        visit.shows("plain")
        visit.scene_shown()
        box = canvas.bounding_box()
        middle = {"x": box["width"] / 2, "y": box["height"] / 2 - 10}
        canvas.hover(position=middle)
        expect(canvas).not_to_have_attribute("data-hovered", "0")
        canvas.click(position=middle)
        expect(page.get_by_role("heading", name="ball")).to_be_visible()
        visit.check_accessible()


def test_a_server_that_cannot_draw_is_said_and_asked_again(place: Place, browser: Browser) -> None:
    with visiting(browser, place.url, f"#/scenes/{place.scene_id}?view={_VIEW}") as visit:
        page = visit.page
        visit.expected.append("ERR_FAILED")
        visit.shows("plain")
        page.route("**/*:render", lambda route: route.abort())
        page.locator("canvas").focus()
        page.keyboard.press("ArrowLeft")
        expect(page.get_by_role("alert")).to_contain_text("cannot be reached")
        page.unroute("**/*:render")
        expect(page.get_by_role("alert")).to_have_count(0)
        expect(page.get_by_text(_SERVER_DRAWS)).to_be_visible()
