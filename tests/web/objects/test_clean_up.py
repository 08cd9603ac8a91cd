"""Cleaning a scene up on the page: what would go is not shown, and what is done is a version."""

from __future__ import annotations

import re

from playwright.sync_api import Browser, Page, Route, expect

from tests.web.browser import visiting
from tests.web.places import Place


def _panel(page: Page) -> None:
    page.get_by_role("tab", name=re.compile("^Objects")).click()
    page.get_by_text("Clean up and crop").click()


def _goes(page: Page) -> int:
    """How many Gaussians the page says would go."""
    said = page.get_by_text(re.compile(r"^[\d,]+ of [\d,]+ Gaussians would go"))
    expect(said).to_be_visible()
    return int(said.inner_text().partition(" of ")[0].replace(",", ""))


def test_what_a_box_says_goes_as_a_version_that_is_undone(place: Place, scene_id: str, browser: Browser) -> None:
    before = place.service.get_scene(scene_id)
    with visiting(browser, place.url, f"#/scenes/{scene_id}") as visit:
        visit.scene_shown()
        page = visit.page
        _panel(page)
        remove = page.get_by_role("button", name="Remove them")
        expect(remove).to_be_disabled()
        page.get_by_label("Crop by a box").check()
        page.get_by_label("Keep what is").select_option("outside the box")
        page.get_by_role("slider", name="Top").fill("0")
        inside = _goes(page)
        assert 0 < inside < before.gaussians
        visit.check_accessible()
        assert place.service.get_scene(scene_id).version == before.version  # looking changes nothing
        remove.click()
        expect(page.get_by_text("Cleaned up.")).to_be_visible()
        after = place.service.get_scene(scene_id)
        assert after.gaussians == before.gaussians - inside
        page.get_by_role("button", name="Undo").click()
        expect(page.get_by_text("Undone.")).to_be_visible()
        assert place.service.get_scene(scene_id).version == before.version


def test_objects_that_are_drawn_over_go(place: Place, scene_id: str, webgl_browser: Browser) -> None:
    ball = next(obj for obj in place.service.answers.list_objects(scene_id).objects if obj.name == "ball")
    with visiting(webgl_browser, place.url, f"#/scenes/{scene_id}") as visit:
        canvas = visit.scene_shown()
        page = visit.page
        page.get_by_role("searchbox").fill("ball")
        expect(page.locator(".verdict.here")).to_be_visible()
        visit.at_rest()
        _panel(page)
        page.get_by_label("Brush over objects").check()
        view = page.url
        box = canvas.bounding_box()
        page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
        page.mouse.down()
        page.mouse.move(box["x"] + box["width"] / 2 + 3, box["y"] + box["height"] / 2, steps=3)
        page.mouse.up()
        expect(page.get_by_text(re.compile(r"\d+ objects? marked"))).to_be_visible()
        assert _goes(page) >= ball.gaussian_count
        visit.at_rest()
        assert page.url == view  # the camera stood still
        routes: list[Route] = []
        page.route("**/*:query", lambda route: routes.append(route))  # kept waiting
        page.get_by_role("button", name="Remove them").click()
        expect(page.get_by_role("tab", name="Objects 2")).to_be_visible()
        visit.at_rest()
        # Until the question is answered anew, nothing is asked of what is no more.
        version = place.service.get_scene(scene_id).version
        assert not [url for url in visit.requests if "/views?" in url and f"version={version}" in url]
        assert page.get_by_role("alert").count() == 0
        for route in routes:
            route.continue_()
        expect(page.get_by_text("Cleaned up.")).to_be_visible()
        assert ball.id not in {obj.id for obj in place.service.answers.list_objects(scene_id).objects}
        visit.tab("Ask")
        expect(page.get_by_text("Not here")).to_be_visible()
