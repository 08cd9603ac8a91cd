"""Objects split and added by clicks on the page, and look-alikes that are settled by a key."""

from __future__ import annotations

import re

import numpy as np
from playwright.sync_api import Browser, expect

from fastsplat_contract.geometry.poses import Pose, Quaternion, Vector3
from fastsplat_contract.messages.scenes import Edit
from tests.web.browser import visiting
from tests.web.places import Place

_NOTE = re.compile(r"Object 4 has \d+ Gaussians")
_VIEW = "0_-3.2_1.6_0_0_0.2"


def _owner(place: Place, scene_id: str) -> np.ndarray:
    return place.service._context.scenes.open(scene_id, "")[0].objects.owner


def test_an_object_is_split_by_a_click_refined_and_undone(place: Place, browser: Browser, scene_id: str) -> None:
    truth = _owner(place, scene_id)
    merged = place.service.versions.edit(scene_id, [Edit("merge", object_ids=(1, 2))])
    with visiting(browser, place.url, f"#/scenes/{scene_id}?view={_VIEW}") as visit:
        canvas, page = visit.scene_shown(), visit.page
        box = canvas.bounding_box()
        ball = {"x": box["width"] / 2, "y": box["height"] / 2 - 10}
        visit.tab("Objects").locator(".object-list").get_by_role("checkbox").first.check()  # without a flight
        page.get_by_role("button", name="Split: click a part").click()
        expect(page.get_by_text("Click the part that is an object of its own.")).to_be_visible()
        visit.check_accessible()
        canvas.click(position=ball)
        expect(page.locator(".tool-note")).to_contain_text(_NOTE)
        visit.check_accessible()
        expect(page.locator(".object-card h2").first).to_have_text("Object 4, no name")
        piece = _owner(place, scene_id) == 4
        overlap = (piece & (truth == 2)).sum() / (piece | (truth == 2)).sum()
        assert overlap > 0.6, overlap
        canvas.click(position={"x": ball["x"] + 15, "y": ball["y"] + 10})
        expect(page.get_by_role("button", name="Done")).to_be_disabled()
        expect(page.locator(".tool-note")).to_contain_text(_NOTE)
        expect(page.get_by_role("button", name="Done")).to_be_enabled()
        current_version = next(version for version in place.service.versions.all(scene_id) if version.current)
        assert current_version.parent == merged.version and current_version.edits[0].prompt is not None
        assert len(current_version.edits[0].prompt.pixels) == 2  # in place of the first one
        page.get_by_role("button", name="Undo it").click()
        expect(page.locator(".object-list li")).to_have_count(2)
    assert place.service.versions.resolve(scene_id) == merged.version


def test_what_is_missing_is_added_by_keyboard_alone(place: Place, browser: Browser, scene_id: str) -> None:
    place.service.versions.edit(scene_id, [Edit("discard", object_ids=(2,))])
    with visiting(browser, place.url, f"#/scenes/{scene_id}?view={_VIEW}") as visit:
        visit.scene_shown()
        page = visit.page
        page.get_by_role("tab", name="Ask").focus()
        page.keyboard.press("ArrowRight")
        page.get_by_role("button", name="Add what is missing").focus()
        page.keyboard.press("Enter")
        middle = page.get_by_role("button", name="Take what is in the middle")
        middle.focus()
        page.keyboard.press("Enter")
        expect(page.locator(".tool-note")).to_contain_text(_NOTE)
        page.get_by_role("button", name="Done").click()
        expect(page.locator(".tool-note")).to_have_count(0)
        expect(page.locator(".object-list li")).to_have_count(3)
    assert (_owner(place, scene_id) == 4).sum() > 200


def test_look_alikes_are_settled_by_one_key_each(place: Place, browser: Browser, scene_id: str) -> None:
    upright = Quaternion(0.0, 0.0, 0.0, 1.0)
    place.service.versions.edit(scene_id, [Edit("unname", object_ids=(1, 2, 3))])
    for height in (0.8, 1.6):
        copy = Edit("duplicate", object_ids=(1,), transform=Pose(Vector3(0.0, 0.0, height), upright))
        place.service.versions.edit(scene_id, [copy])
    with visiting(browser, place.url, f"#/scenes/{scene_id}?view={_VIEW}") as visit:
        canvas, page = visit.scene_shown(), visit.page
        visit.tab("Objects").locator(".object-list").get_by_role("button", name="Object 1").click()
        visit.name_object("violin")
        panel = page.locator(".look-alikes")
        expect(panel).to_contain_text("is it “violin”, too?")
        expect(canvas).to_have_attribute("data-hovered", re.compile("[45]"))
        visit.check_accessible()
        canvas.focus()
        page.keyboard.press("y")
        expect(panel).to_contain_text("Object 5")
        page.keyboard.press("n")
        expect(panel).to_have_count(0)
        expect(page.locator(".object-list")).to_contain_text("Object 5, no name")
    names = [obj.name for obj in place.service.answers.list_objects(scene_id).objects]
    assert names == ["violin", "", "", "violin", ""]
