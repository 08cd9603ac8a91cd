"""The name of a scene is edited in place."""

from __future__ import annotations

from playwright.sync_api import Browser, expect

from fastsplat_contract.messages.scenes import SceneUpdate
from tests.web.browser import PHONE, Visit, visiting
from tests.web.places import MARKUP, Place


def _rename(visit: Visit, name: str) -> None:
    visit.page.get_by_role("button", name="Rename").click()
    expect(visit.page.get_by_label("Name of the scene")).to_be_focused()
    visit.page.get_by_label("Name of the scene").fill(name)
    visit.page.keyboard.press("Enter")


def test_a_scene_is_renamed_and_markup_stays_text(place: Place, browser: Browser, scene_id: str) -> None:
    with visiting(browser, place.url, f"#/scenes/{scene_id}", **PHONE) as visit:
        _rename(visit, MARKUP)
        expect(visit.page.get_by_role("heading", level=1)).to_have_text(MARKUP)
        expect(visit.page.get_by_role("button", name="Rename")).to_be_focused()
        assert place.service.get_scene(scene_id).name == MARKUP
        visit.page.get_by_role("button", name="Rename").click()
        visit.check_accessible()
        assert visit.fits()
        visit.page.get_by_label("Name of the scene").fill("not this one")
        visit.page.keyboard.press("Escape")
        expect(visit.page.get_by_role("heading", level=1)).to_have_text(MARKUP)
        visit.page.goto(f"{place.url}/#/")
        expect(visit.page.get_by_role("link", name=MARKUP)).to_be_visible()
    assert place.service.get_scene(scene_id).name == MARKUP


def test_a_name_that_somebody_else_gave_meanwhile_is_not_overwritten(
    place: Place, browser: Browser, scene_id: str
) -> None:
    with visiting(browser, place.url, f"#/scenes/{scene_id}") as visit:
        visit.expected.append("409")
        expect(visit.page.get_by_role("heading", level=1)).to_have_text("own")
        place.service.update_scene(scene_id, SceneUpdate("theirs"))
        _rename(visit, "mine")
        expect(visit.page.get_by_role("alert")).to_contain_text("another name by now")
        expect(visit.page.get_by_role("heading", level=1)).to_have_text("theirs")
        expect(visit.page.get_by_label("Name of the scene")).to_have_value("mine")
        visit.page.keyboard.press("Enter")
        expect(visit.page.get_by_role("heading", level=1)).to_have_text("mine")
    assert place.service.get_scene(scene_id).name == "mine"
