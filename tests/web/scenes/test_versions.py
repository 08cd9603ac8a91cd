"""Versions on the page: undone and redone by keyboard, listed, restored, compared."""

from __future__ import annotations

import re

import numpy as np
from playwright.sync_api import Browser, expect

from fastsplat_contract.messages.scenes import Color, Edit
from tests.web.browser import PHONE, drawn_canvas, visiting
from tests.web.places import MARKUP, Place


def _names(place: Place, scene_id: str) -> list[str]:
    return [obj.name for obj in place.service.answers.list_objects(scene_id).objects]


def test_undo_and_redo_by_keyboard(place: Place, browser: Browser, scene_id: str) -> None:
    place.service.versions.edit(scene_id, [Edit("name", object_ids=(1,), name="violin")])
    place.service.versions.edit(scene_id, [Edit("merge", object_ids=(1, 2))])
    with visiting(browser, place.url, f"#/scenes/{scene_id}", **PHONE, color_scheme="dark") as visit:
        canvas, rows = visit.scene_shown(), visit.tab("Objects").locator(".object-list li")
        expect(rows).to_have_count(2)
        canvas.focus()
        for key, count, name in (
            ("Control+z", 3, "violin"),
            ("Control+z", 3, "mug"),
            ("Control+y", 3, "violin"),
            ("Control+Shift+Z", 2, "violin"),
        ):
            visit.page.keyboard.press(key)
            expect(rows).to_have_count(count)
            expect(rows.first).to_contain_text(name)
            assert (len(_names(place, scene_id)), _names(place, scene_id)[0]) == (count, name)
        visit.page.locator(".versions summary").click()
        assert visit.fits()
        visit.check_accessible()
        visit.tab("Ask")
        visit.page.get_by_role("searchbox").fill("moon")
        visit.page.keyboard.press("Control+z")  # takes back what was typed, and no edit
        expect(visit.page.get_by_role("button", name="Redo")).to_be_disabled()
    assert len(_names(place, scene_id)) == 2


def test_versions_are_listed_compared_and_restored(place: Place, webgl_browser: Browser, scene_id: str) -> None:
    trained = place.service.versions.resolve(scene_id)
    place.service.versions.edit(scene_id, [Edit("recolor", object_ids=(1,), color=Color(0.0, 0.0, 1.0))])
    named = place.service.versions.edit(scene_id, [Edit("name", object_ids=(1,), name=MARKUP)])
    with visiting(webgl_browser, place.url, f"#/scenes/{scene_id}?view=0_-3.2_1.6_0_0_0.2") as visit:
        canvas, page = visit.scene_shown(), visit.page
        visit.tab("Objects").locator(".versions summary").click()
        rows = page.locator(".versions li")
        expect(rows).to_have_count(3)
        expect(rows.first).to_contain_text(f"Named object 1 “{MARKUP}”")
        expect(rows.last).to_contain_text("As it was trained")
        visit.check_accessible()
        here = drawn_canvas(page)
        url = page.url
        rows.last.get_by_role("button", name="Compare").click()
        expect(canvas).to_have_attribute("data-shown", re.compile(f"^{trained} "))
        expect(page.get_by_text("On show: As it was trained.")).to_be_visible()
        visit.check_accessible()
        assert drawn_canvas(page) != here and page.url == url  # from the same place
        rows.last.get_by_role("button", name="Compare").click()
        expect(canvas).not_to_have_attribute("data-shown", re.compile(f"^{trained} "))
        assert len([url for url in visit.requests if "scene.spz" in url]) == 2
        assert place.service.versions.resolve(scene_id) == named.version  # to look is no change
        rows.last.get_by_role("button", name="Restore").click()
        expect(page.get_by_text("Restored: As it was trained.")).to_be_visible()
        assert place.service.versions.resolve(scene_id) == trained
        expect(page.locator(".versions li.undone")).to_have_count(2)
        page.get_by_role("button", name="Redo").click()
        expect(page.locator(".versions li.undone")).to_have_count(1)
        visit.check_accessible()
    first = np.array([version.current for version in place.service.versions.all(scene_id)])
    assert first.tolist() == [False, True, False]
