"""Objects on the page: pointed at, clicked, named, merged, discarded, undone, and worked through by keyboard."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
from playwright.sync_api import Browser, Locator, Route, expect

from fastsplat.service.query.objects.labeled_objects import label_gaussians
from fastsplat.service.scene.artefact.scene import Object, ObjectGroup, Objects, Parts
from fastsplat.service.scene.objects.label_evidence import UNIT, evidence_of
from fastsplat_contract.jobs.name_suggestions import SuggestedName
from fastsplat_contract.messages.scenes import Edit
from tests.api.made_scene import LABELS
from tests.scenes import store_scene
from tests.web.browser import visiting
from tests.web.places import MARKUP, Place
from tests.web.table import table

_VIEW = "0_-3.2_1.6_0_0_0.2"
_BESIDE = 150  # pixels from there to what lies on its right


def _middle(canvas: Locator) -> dict[str, float]:
    """Where the picture shows the ball, from `_VIEW`."""
    box = canvas.bounding_box()
    return {"x": box["width"] / 2, "y": box["height"] / 2 - 10}


def test_an_object_is_clicked_named_asked_for_and_the_name_undone(
    place: Place, webgl_browser: Browser, scene_id: str
) -> None:
    with visiting(webgl_browser, place.url, f"#/scenes/{scene_id}?view={_VIEW}") as visit:
        canvas, page = visit.scene_shown(), visit.page
        canvas.click(position=_middle(canvas))
        card = page.locator(".object-card")
        expect(card.get_by_role("heading", name="ball")).to_be_visible()
        expect(card).to_contain_text("Gaussians")
        expect(card).to_contain_text(re.compile(r"\d\.\d\d × \d\.\d\d × \d\.\d\d m"))
        visit.check_accessible()
        visit.expected.append("400")
        visit.name_object("v" * 201)
        expect(page.get_by_role("alert")).to_contain_text("200 characters")
        visit.name_object("violin")
        expect(page.get_by_text("Named “violin”.")).to_be_visible()
        visit.tab("Ask")
        page.get_by_role("searchbox").fill("violin")
        expect(page.locator(".verdict.here")).to_be_visible()
        expect(page.get_by_role("button", name="Look at violin 1")).to_be_visible()
        expect(canvas).to_have_attribute("data-shown", re.compile("answer$"))
        assert len([url for url in visit.requests if "scene.spz" in url]) == 1  # a name changes no Gaussian

        page.reload()
        expect(page.get_by_role("searchbox")).to_have_value("violin")
        expect(page.locator(".verdict.here")).to_be_visible()
        page.get_by_role("button", name="Undo").click()
        expect(page.get_by_text("Not here")).to_be_visible()
        expect(visit.tab("Objects").locator(".object-list")).to_contain_text("ball")
        page.reload()
        expect(page.get_by_text("Not here")).to_be_visible()
    (first, *_) = place.service.versions.all(scene_id)
    assert first.current


def test_a_second_click_takes_the_next_level_and_a_part_is_named(place: Place, webgl_browser: Browser) -> None:
    """Of the balls on the table: the upper half of the second is a part, and all three are a group."""
    service, settings = place.service, place.settings
    scene = table(settings)
    rows = np.arange(len(scene.gaussians))
    owner = label_gaussians(scene).classes
    half = np.flatnonzero((owner == 2) & (scene.gaussians.means[:, 2] > 0.3))
    objects = Objects(
        tuple(
            Object(number, label, "detected", 0.97, surface="surface" if number == 3 else "")
            for number, label in enumerate(LABELS, start=1)
        ),
        evidence_of(rows, owner, np.full(len(rows), 50 * UNIT), len(rows)),
        0,
        Parts(
            (Object(4, parent=2),), evidence_of(half, np.full(len(half), 4), np.full(len(half), 50 * UNIT), len(rows))
        ),
        groups=(ObjectGroup(5, (1, 2, 3), 0.9),),
    )
    scene_id = store_scene(service._store, replace(scene, objects=objects), "levels")
    with visiting(webgl_browser, place.url, f"#/scenes/{scene_id}?view={_VIEW}") as visit:
        canvas, page = visit.scene_shown(), visit.page
        here = _middle(canvas) | {"y": _middle(canvas)["y"] - 30}
        card = page.locator(".object-card")
        for said, heading in (
            ("Selected: ball. Click again for group: ball and 2 more.", "ball"),
            ("Selected: group: ball and 2 more. Click again for part of ball.", "3 objects selected"),
            ("Selected: part of ball. Click again for ball.", "Object 4, no name"),
        ):
            canvas.click(position=here)
            expect(page.get_by_text(said, exact=True)).to_be_visible()
            expect(card.get_by_role("heading", name=heading)).to_be_visible()
            visit.check_accessible()
        visit.name_object("violin")
        expect(card.get_by_role("heading", name="violin")).to_be_visible()
        expect(page.get_by_role("tab", name="Objects 2", exact=True)).to_be_visible()
        expect(visit.tab("Objects").get_by_text("2 objects and 1 surface. All objects have names.")).to_be_visible()
    (part,) = (obj for obj in service.answers.list_objects(scene_id, parts=True).objects if obj.parent)
    assert (part.id, part.name) == (4, "violin")
    service.delete_scene(scene_id)


def test_other_names_are_given_and_a_proper_name_is_asked_for_its_kind_once(
    place: Place, browser: Browser, scene_id: str
) -> None:
    """The server has no lexicon and asks nothing, so that its answer is changed on the way."""

    def asks(route: Route) -> None:
        response = route.fetch()
        named = json.loads(route.request.post_data or "")["edits"][0]
        route.fulfill(response=response, json={**response.json(), "asks_kind": not named.get("kinds")})

    with visiting(browser, place.url, f"#/scenes/{scene_id}") as visit:
        visit.scene_shown()
        page, card = visit.page, visit.page.locator(".object-card")
        page.route("**/*:edit", asks)
        visit.tab("Objects").get_by_role("button", name="ball").click()
        card.get_by_label("Name", exact=True).fill("violin")
        card.get_by_label("Other names, separated by commas").fill("moon, fiddle")
        card.get_by_role("button", name="Save the name").click()
        expect(card.get_by_text("Also called moon, fiddle.")).to_be_visible()
        visit.check_accessible()
        card.get_by_label("violin is a …").fill("toy, instrument")
        card.get_by_role("button", name="Save what it is").click()
        expect(card.get_by_text("Also called moon, fiddle, violin toy, violin instrument.")).to_be_visible()
        expect(card.get_by_label("violin is a …")).to_have_count(0)
        visit.name_object("carrot")
        card.get_by_role("button", name="Do not say").click()
        expect(card.get_by_label("carrot is a …")).to_have_count(0)
        page.unroute("**/*:edit")


def test_a_click_with_shift_adds_what_an_object_lacks_and_both_are_made_one(
    place: Place, webgl_browser: Browser, scene_id: str
) -> None:
    with visiting(webgl_browser, place.url, f"#/scenes/{scene_id}?view={_VIEW}") as visit:
        canvas, page = visit.scene_shown(), visit.page
        middle = _middle(canvas)
        beside = middle | {"x": middle["x"] + _BESIDE}
        canvas.click(position=middle)
        expect(page.locator(".object-card").get_by_role("heading", name="ball")).to_be_visible()
        for selected in ("2 objects selected", "1 object selected", "2 objects selected"):
            canvas.click(position=beside, modifiers=["Shift"])
            expect(page.get_by_role("region", name=selected)).to_be_visible()
        page.get_by_role("button", name="Merge into one").click()
        expect(page.get_by_text("Merged.")).to_be_visible()
        for position in (middle, beside):
            canvas.hover(position=position)
            expect(canvas).to_have_attribute("data-hovered", "2")
            page.mouse.move(5, 5)
            expect(canvas).to_have_attribute("data-hovered", "0")
    names = [obj.name for obj in place.service.answers.list_objects(scene_id).objects]
    assert len(names) == 2 and "ball" in names


def test_two_objects_are_merged_and_one_discarded(place: Place, browser: Browser, scene_id: str) -> None:
    with visiting(browser, place.url, f"#/scenes/{scene_id}") as visit:
        visit.scene_shown()
        page, rows = visit.page, visit.tab("Objects").locator(".object-list li")
        page.get_by_role("checkbox", name="Select mug").check()
        page.get_by_role("checkbox", name="Select ball").check()
        expect(page.get_by_role("heading", name="2 objects selected")).to_be_visible()
        visit.check_accessible()
        page.get_by_role("button", name="Merge into one").click()
        expect(page.get_by_text("Merged.")).to_be_visible()
        expect(rows).to_have_count(2)
        page.locator(".object-list").get_by_role("button", name="story book").click()
        page.get_by_role("button", name="Discard").click()
        expect(rows).to_have_count(1)
        for count in (2, 3):
            page.get_by_role("button", name="Undo").click()
            expect(rows).to_have_count(count)


def test_objects_without_a_name_are_named_by_an_answer_and_worked_through_by_keyboard(
    place: Place, browser: Browser, scene_id: str
) -> None:
    ids = [obj.id for obj in place.service.answers.list_objects(scene_id).objects]
    place.service.versions.edit(scene_id, [Edit("unname", object_ids=tuple(ids))])
    with visiting(browser, place.url, f"#/scenes/{scene_id}?q=where+is+the+submarine") as visit:
        visit.scene_shown()
        page = visit.page
        expect(page.locator(".verdict.cannot_say")).to_be_visible()
        visit.check_accessible()
        page.get_by_role("button", name="Yes, it is “submarine”").first.click()
        expect(page.locator(".verdict.here")).to_be_visible()
        page.get_by_role("button", name="Undo").click()
        expect(page.get_by_text("Undone.")).to_be_visible()
        visit.tab("Objects")
        expect(page.get_by_text("3 objects without a name")).to_be_visible()
        page.get_by_role("button", name="Name the next one").focus()
        page.keyboard.press("Enter")
        for number, name in zip(ids, ("elephant", MARKUP, "moon"), strict=True):
            expect(page.get_by_label(f"Object {number}, no name", exact=True)).to_be_focused()
            page.keyboard.type(name)
            page.keyboard.press("Enter")
            expect(page.get_by_text(f"Named “{name}”.")).to_be_visible()
        expect(page.get_by_text("All objects have names.")).to_be_visible()
    names = [obj.name for obj in place.service.answers.list_objects(scene_id).objects]
    assert names == ["elephant", MARKUP, "moon"]


def test_suggested_names_are_taken_by_one_key_an_object_or_all_likely_ones_at_once(
    place: Place, browser: Browser, scene_id: str
) -> None:
    ids = [obj.id for obj in place.service.answers.list_objects(scene_id).objects]
    suggestions = [
        SuggestedName(ids[0], "elephant", 0.9, "eyes", "eyes:7b", ("jumbo",)),
        SuggestedName(ids[1], MARKUP, 0.6, MARKUP),
        SuggestedName(ids[2], "moon", 0.85, "eyes", "eyes:7b"),
    ]
    place.service.versions.edit(scene_id, [Edit("unname", object_ids=tuple(ids))])
    place.service.versions.edit(scene_id, [Edit("suggest", suggestions=tuple(suggestions))])
    with visiting(browser, place.url, f"#/scenes/{scene_id}") as visit:
        visit.scene_shown()
        page = visit.page
        visit.tab("Objects")
        page.evaluate("addEventListener('keydown', () => (window.keys = (window.keys ?? 0) + 1), true)")
        page.get_by_role("button", name="Name the next one").focus()
        page.keyboard.press("Enter")
        for told_of in suggestions:
            field = page.get_by_label(f"Object {told_of.object_id}, no name", exact=True)
            expect(field).to_be_focused()
            expect(field).to_have_value(told_of.name)
            says = rf"Suggested: {re.escape(told_of.name)} \(\d+ %, says {re.escape(told_of.source)}\)"
            expect(page.locator("#who-says")).to_contain_text(re.compile(says))
            visit.check_accessible()
            page.keyboard.press("Enter")
            expect(page.get_by_text(f"Named “{told_of.name}”.")).to_be_visible()
        expect(page.get_by_text("All objects have names.")).to_be_visible()
        assert page.evaluate("window.keys") == 1 + len(suggestions)
        for _ in suggestions:
            page.get_by_role("button", name="Undo").click()
            expect(page.get_by_text("Undone.")).to_be_visible()
        expect(page.get_by_text("3 objects without a name")).to_be_visible()
        page.evaluate("window.keys = 0")
        page.get_by_role("button", name="Name the next one").focus()
        page.keyboard.press("Tab")
        expect(page.get_by_role("button", name="Take 2 names of 80 % and more")).to_be_focused()
        page.keyboard.press("Enter")
        expect(page.get_by_text("2 names taken.")).to_be_visible()
        expect(page.get_by_text("1 object without a name")).to_be_visible()
        assert page.evaluate("window.keys") == 2
        # What is filled in is taken by nobody who clears it.
        page.get_by_role("button", name="Name the next one").click()
        expect(page.get_by_label(f"Object {ids[1]}, no name", exact=True)).to_be_focused()
        page.keyboard.press("Backspace")
        page.keyboard.press("Enter")
        expect(page.get_by_role("button", name="Name the next one")).to_be_visible()
    assert [obj.name for obj in place.service.answers.list_objects(scene_id).objects] == ["elephant", "", "moon"]
    assert {"jumbo"} <= {alias for entry in place.service.get_scene(scene_id).dictionary for alias in entry.aliases}


def test_a_change_by_somebody_else_is_seen(place: Place, browser: Browser, scene_id: str) -> None:
    with visiting(browser, place.url, f"#/scenes/{scene_id}") as visit:
        visit.scene_shown()
        place.service.versions.edit(scene_id, [Edit("name", object_ids=(1,), name="volcano")])
        expect(visit.tab("Objects").locator(".object-list")).to_contain_text("volcano")
        expect(visit.page.get_by_text("The scene has changed.")).to_be_visible()


def test_a_name_that_another_person_gave_meanwhile_is_not_lost(place: Place, browser: Browser, scene_id: str) -> None:
    with visiting(browser, place.url, f"#/scenes/{scene_id}") as visit:
        visit.scene_shown()
        visit.expected.append("40")
        visit.page.route("**/versions", lambda route: route.abort())  # the page does not notice
        visit.expected.append("ERR_FAILED")
        place.service.versions.edit(scene_id, [Edit("name", object_ids=(1,), name="volcano")])
        visit.tab("Objects").locator(".object-list").get_by_role("button", name="mug").click()
        visit.name_object("moon")
        expect(visit.page.get_by_role("alert").first).to_contain_text("volcano")


def test_objects_are_walked_to_and_selected_by_keyboard_in_the_picture(place: Place, browser: Browser) -> None:
    with visiting(browser, place.url, f"#/scenes/{place.scene_id}?view={_VIEW}") as visit:
        canvas, page = visit.scene_shown(), visit.page
        canvas.focus()
        page.keyboard.press("Enter")
        expect(canvas).to_have_attribute("data-hovered", "2")  # the ball, in the middle
        page.keyboard.press("ArrowRight")
        expect(canvas).to_have_attribute("data-hovered", "3")
        for _ in range(2):
            page.keyboard.press("ArrowLeft")
        expect(canvas).to_have_attribute("data-hovered", "1")
        visit.at_rest()
        assert f"view={_VIEW}" in page.url or "view=" not in page.url  # nobody turns the view meanwhile
        page.keyboard.press("Enter")
        expect(page.locator(".object-card").get_by_role("heading", name="mug")).to_be_visible()
        page.keyboard.press("Escape")
        expect(canvas).to_have_attribute("data-hovered", "0")
        page.keyboard.press("Escape")
        expect(page.locator(".object-card")).to_have_count(0)
        page.keyboard.press("/")
        expect(page.get_by_role("searchbox")).to_be_focused()
