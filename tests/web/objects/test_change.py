"""Changes on the page: hidden, shown alone, recolored, removed, moved with the handles, copied; what the server has."""

from __future__ import annotations

import re

import numpy as np
import pytest
from numpy.typing import NDArray
from playwright.sync_api import Browser, Locator, Page, expect

from fastsplat.service.scene.artefact.scene import Gaussians
from tests.web.browser import TOUCH_PHONE, Visit, visiting
from tests.web.glow import canvas_pixels
from tests.web.places import Place

_VIEW = "0_-3.2_1.6_0_0_0.2"


def _picture(page: Page) -> NDArray[np.float64]:
    """The 3D picture without what lies over it, [H, W, 3] of 0..255."""
    return 255 * canvas_pixels(page)


def _gaussians(place: Place, scene_id: str, version: str = "") -> Gaussians:
    return place.service._context.scenes.open(scene_id, version)[0].scene.gaussians


def _menu(visit: Visit, obj: str = "ball") -> Locator:
    visit.tab("Objects").locator(".object-list").get_by_role("button", name=obj).click()
    return visit.page.get_by_role("region", name="Change")


def test_an_object_is_moved_with_a_handle_on_show_and_then_on_the_server(
    place: Place, webgl_browser: Browser, scene_id: str
) -> None:
    before = _gaussians(place, scene_id)
    with visiting(webgl_browser, place.url, f"#/scenes/{scene_id}?view={_VIEW}") as visit:
        visit.scene_shown()
        page, menu = visit.page, _menu(visit)
        menu.get_by_role("button", name="Move or turn").click()
        here = _picture(page)
        handle = page.get_by_role("button", name="Shift along z")
        box = handle.bounding_box()
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(x, y - 30, steps=3)
        page.mouse.move(x, y - 60, steps=3)
        page.mouse.up()
        page.get_by_role("button", name="Turn about z").focus()
        for _ in range(6):
            page.keyboard.press("ArrowUp")
        panel = page.locator(".move")
        expect(panel.get_by_label("z", exact=True).last).to_have_value("30")
        visit.check_accessible()
        preview = _picture(page)
        assert np.abs(preview - here).mean() > 1  # it moves on show
        assert len(place.service.versions.all(scene_id)) == 1  # and nowhere else
        panel.get_by_role("button", name="Move it").click()
        expect(page.get_by_text("Moved.")).to_be_visible()
        expect(page.locator("canvas")).to_have_attribute("data-shown", re.compile("^e"))
        moved = _picture(page)
        assert np.abs(moved - preview).mean() < 0.15 * np.abs(preview - here).mean()
    version = place.service.versions.all(scene_id)[-1]
    (edit,) = version.edits
    assert edit.action == "move" and edit.object_ids == (2,) and edit.transform is not None
    matrix, after = edit.transform.matrix(), _gaussians(place, scene_id)
    assert 0.1 < matrix[2, 3] < 2 and matrix[1, 0] == pytest.approx(0.5, abs=1e-6)
    rows = (after.means != before.means).any(axis=1)
    ball = (np.linalg.norm(before.means - [0.0, 0.3, 0.3], axis=1) < 0.31) & (before.means[:, 2] > 0.05)
    assert (ball <= rows).all()
    expected = before.means[rows] @ matrix[:3, :3].T + matrix[:3, 3]
    np.testing.assert_allclose(after.means[rows], expected, atol=1e-5)


def test_a_copy_is_placed_by_numbers(place: Place, browser: Browser, scene_id: str) -> None:
    with visiting(browser, place.url, f"#/scenes/{scene_id}?view={_VIEW}") as visit:
        visit.scene_shown()
        menu = _menu(visit, "mug")
        menu.get_by_role("button", name="Move or turn").click()
        visit.page.locator(".move").get_by_label("y", exact=True).first.fill("-0.8")
        visit.page.locator(".move").get_by_role("button", name="Place a copy there").click()
        expect(visit.page.get_by_text("Copied.")).to_be_visible()
        expect(visit.page.locator(".object-list li")).to_have_count(4)
    objects = place.service.answers.list_objects(scene_id).objects
    mugs = [obj for obj in objects if obj.name == "mug"]
    assert len(mugs) == 2 and mugs[0].box is not None and mugs[1].box is not None
    offset = np.subtract(mugs[1].box.center.position, mugs[0].box.center.position)
    np.testing.assert_allclose(offset, [0.0, -0.8, 0.0], atol=1e-4)


def test_an_object_is_recolored_and_removed_and_both_are_undone(
    place: Place, webgl_browser: Browser, scene_id: str
) -> None:
    count, trained = len(_gaussians(place, scene_id)), place.service.versions.resolve(scene_id)
    with visiting(webgl_browser, place.url, f"#/scenes/{scene_id}?view={_VIEW}") as visit:
        visit.scene_shown()
        page, menu = visit.page, _menu(visit)
        menu.get_by_label("New color").fill("#ff00ff")
        menu.get_by_role("button", name="Recolor").click()
        expect(page.get_by_text("Recolored.")).to_be_visible()
        assert place.service.versions.all(scene_id)[-1].edits[0].color == (1.0, 0.0, 1.0)
        recolored = place.service.versions.resolve(scene_id)
        menu.get_by_role("button", name="Remove").click()
        expect(page.get_by_text("Removed.")).to_be_visible()
        expect(page.locator(".object-list li")).to_have_count(2)
        assert len(_gaussians(place, scene_id)) < count - 500
        for version in (recolored, trained):
            page.locator("canvas").focus()
            page.keyboard.press("Control+z")
            expect(page.get_by_text("Undone.")).to_be_visible()
            expect(page.locator("canvas")).to_have_attribute("data-shown", re.compile(f"^{version} "))
        expect(page.locator(".object-list li")).to_have_count(3)
    assert len(_gaussians(place, scene_id)) == count


def test_what_is_hidden_or_shown_alone_is_no_version(place: Place, webgl_browser: Browser, scene_id: str) -> None:
    with visiting(webgl_browser, place.url, f"#/scenes/{scene_id}?view={_VIEW}") as visit:
        visit.scene_shown()
        page, menu = visit.page, _menu(visit)
        here = _picture(page)
        menu.get_by_role("button", name="Hide").click()
        hidden = _picture(page)
        menu.get_by_role("button", name="Show alone").click()
        alone = _picture(page)
        lit = [(picture.sum(axis=2) > 60).sum() for picture in (here, hidden, alone)]
        assert lit[2] < 0.4 * lit[0] and np.abs(here - hidden).mean() > 1
        page.get_by_role("button", name="Show everything").click()
        assert np.abs(_picture(page) - here).mean() < 0.5
        visit.check_accessible()
    assert len(place.service.versions.all(scene_id)) == 1


def test_changing_on_a_phone(place: Place, browser: Browser, scene_id: str) -> None:
    with visiting(browser, place.url, f"#/scenes/{scene_id}?view={_VIEW}", **TOUCH_PHONE) as visit:
        visit.scene_shown()
        menu = _menu(visit)
        menu.get_by_role("button", name="Move or turn").click()
        expect(visit.page.get_by_role("button", name="Shift along x")).to_be_visible()
        assert visit.fits()
        visit.check_accessible()
