"""The ruler on the page: lengths by clicks and by keyboard, in scene units until a known length makes them meters."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest
from playwright.sync_api import Browser, Locator, expect

from tests.scenes import store_scene
from tests.web.browser import PHONE, Visit, visiting
from tests.web.glow import page_view
from tests.web.places import Place
from tests.web.table import table

_VIEW = "0_-3.2_1.6_0_0_0.2"


@pytest.fixture
def scene_id(place: Place) -> str:
    """A scene without a scale."""
    return store_scene(place.service._store, replace(table(place.settings), scale="ARBITRARY"), "own")


def _ruler(visit: Visit) -> Locator:
    visit.page.get_by_role("group", name="Tools").get_by_role("button", name="Measure").click()
    note = visit.page.locator(".tool-note")
    expect(note).to_contain_text("Click the first of two places.")
    return note


def _measured(visit: Visit, canvas: Locator) -> Locator:
    """The note, after a length on the table was clicked."""
    note, box = _ruler(visit), canvas.bounding_box()
    canvas.click(position={"x": box["width"] / 2, "y": box["height"] / 2 + 60})
    expect(note).to_contain_text("Click the second place.")
    canvas.click(position={"x": box["width"] / 2 + 100, "y": box["height"] / 2 + 60})
    return note


def test_a_known_length_makes_the_scene_metric_and_undo_takes_it_back(
    place: Place, webgl_browser: Browser, scene_id: str
) -> None:
    with visiting(webgl_browser, place.url, f"#/scenes/{scene_id}?view={_VIEW}") as visit:
        canvas, page = visit.scene_shown(), visit.page
        note = _measured(visit, canvas)
        expect(note).to_contain_text(re.compile(r"are \d\.\d{3} scene units ± \d\.\d{3} apart"))
        assert " m " not in note.inner_text()
        visit.check_accessible()
        note.get_by_label("This length is really (meters)").fill("0.25")
        note.get_by_role("button", name="Set the scale").click()
        expect(page.get_by_text("The scene is in meters now.")).to_be_visible()
        visit.tab("Objects")
        expect(page.get_by_text(re.compile(r"In meters by 1 known length, ± [\d.]+ %"))).to_be_visible()
        scene = place.service.get_scene(scene_id)
        assert scene.scale == "METRIC" and scene.scaling is not None and scene.scaling.meters_per_unit < 1
        (edit,) = place.service.versions.all(scene_id)[-1].edits
        assert [known.meters for known in edit.known_lengths] == [0.25]
        expect(page).not_to_have_url(re.compile(_VIEW))
        assert page_view(page)[1] == pytest.approx(-3.2 * scene.scaling.meters_per_unit, rel=1e-3)  # the picture stays
        note = _measured(visit, canvas)
        expect(note).to_contain_text(re.compile(r"are 0\.2[45]\d m ± \d\.\d{3} m apart"))
        page.get_by_role("button", name="Put the ruler away").click()
        page.get_by_role("button", name="Undo").click()
        expect(page.get_by_text("In meters by")).to_have_count(0)
    assert place.service.get_scene(scene_id).scale == "ARBITRARY"


def test_measuring_by_keyboard_alone(place: Place, browser: Browser, scene_id: str) -> None:
    with visiting(browser, place.url, f"#/scenes/{scene_id}?view={_VIEW}", **PHONE) as visit:
        visit.scene_shown()
        note = _ruler(visit)
        visit.page.locator("canvas").focus()
        visit.page.keyboard.press("Enter")  # takes what the crosshair is on
        expect(note).to_contain_text("Click the second place.")
        note.get_by_label("Or a point: x, y, z").fill("0, 0, 5.0")
        visit.page.keyboard.press("Enter")
        expect(note).to_contain_text("scene units")
        note.get_by_label("Or a point: x, y, z").fill("0 0 0")
        visit.page.keyboard.press("Enter")
        expect(note).to_contain_text("Click the second place.")
        note.get_by_label("Or a point: x, y, z").fill("0 3 4")
        visit.page.keyboard.press("Enter")
        expect(note).to_contain_text("5.000 scene units ± 0.000")
        assert visit.fits()
        visit.check_accessible()
        visit.page.locator("canvas").focus()
        visit.page.keyboard.press("Escape")
        expect(note).to_have_count(0)
