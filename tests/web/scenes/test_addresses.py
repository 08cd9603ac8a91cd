"""What a person looks at has an address: it comes back after a reload, in another browser, and with "back"."""

from __future__ import annotations

import re

from playwright.sync_api import Browser, Page, expect

from fastsplat_contract.messages.scenes import Edit
from tests.web.browser import Visit, visiting
from tests.web.places import Place

_VIEW = "0.9_-2.6_1.9_0_0_0.2"


def _object(place: Place, scene_id: str, name: str, version: str = "") -> int:
    return next(obj.id for obj in place.service.answers.list_objects(scene_id, version).objects if obj.name == name)


def _expect_all(page: Page, text: str, selected: str, view: str) -> None:
    expect(page.get_by_role("searchbox")).to_have_value(text)
    expect(page.locator(".verdict.here")).to_be_visible()
    expect(page.locator("canvas")).to_have_attribute("data-shown", re.compile("answer$"))
    Visit(page).at_rest()
    assert f"view={view}" in page.url
    expect(page.locator(".glow-legend")).to_have_text(f"Answers “{text}”")  # one light at a time
    Visit(page).tab("Objects")
    expect(page.get_by_role("heading", name=selected)).to_be_visible()
    if selected != "Objects":
        expect(page.locator(".glow-legend")).to_have_text(f"Selected: {selected}")


def test_question_view_and_selection_come_back_here_and_elsewhere(place: Place, browser: Browser) -> None:
    with visiting(browser, place.url, f"#/scenes/{place.scene_id}?view={_VIEW}") as visit:
        page = visit.page
        visit.tab("Objects").get_by_role("button", name="ball").click()
        expect(page.get_by_role("heading", name="ball")).to_be_visible()
        visit.tab("Ask")
        page.get_by_role("searchbox").fill("mug")
        expect(page.locator(".verdict.here")).to_be_visible()
        ball = _object(place, place.scene_id, "ball")
        expect(page).to_have_url(re.compile(f"q=mug.*view=.*objects={ball}$"))
        visit.at_rest()
        address, view = page.url, re.findall("view=([^&]+)", page.url)[0]
        page.reload()
        _expect_all(page, "mug", "ball", view)
        assert page.url == address
    with visiting(browser, place.url, address.removeprefix(f"{place.url}/")) as elsewhere:
        _expect_all(elsewhere.page, "mug", "ball", view)
        assert elsewhere.page.url == address


def test_an_edit_leaves_question_and_selection_as_they_are(place: Place, browser: Browser) -> None:
    scene_id = place.new_scene("edited")
    with visiting(browser, place.url, f"#/scenes/{scene_id}") as visit:
        page = visit.page
        visit.scene_shown()
        page.goto(f"{place.url}/#/scenes/{scene_id}?q=mug")  # followed while a version is on show
        expect(page.locator(".verdict.here")).to_be_visible()
        visit.tab("Objects").get_by_role("button", name="ball").click()
        visit.tab("Ask")
        page.get_by_role("searchbox").fill("story book")
        expect(page.get_by_role("button", name="Look at story book 1")).to_be_visible()
        visit.tab("Objects")
        visit.name_object("violin")
        expect(page.get_by_role("heading", name="violin")).to_be_visible()
        visit.at_rest()
        expect(page.get_by_role("heading", name="violin")).to_be_visible()
        visit.tab("Ask")
        expect(page.get_by_role("searchbox")).to_have_value("story book")
        assert "violin" in {obj.name for obj in place.service.answers.list_objects(scene_id).objects}


def test_an_older_version_has_an_address(place: Place, browser: Browser) -> None:
    scene_id = place.new_scene("versions")
    old = place.service.get_scene(scene_id).version
    ball = _object(place, scene_id, "ball")
    place.service.versions.edit(scene_id, (Edit("name", object_ids=(ball,), name="violin"),), looked_at=old)
    address = f"#/scenes/{scene_id}?version={old}&objects={ball}"
    with visiting(browser, place.url, address) as visit:
        page = visit.page
        expect(page.get_by_text("This is an older version.")).to_be_visible()
        expect(page.get_by_role("heading", name="ball")).to_be_visible()
        page.reload()
        expect(page.get_by_text("This is an older version.")).to_be_visible()
        page.get_by_role("link", name="Show the current one").click()
        expect(page.get_by_role("heading", name="violin")).to_be_visible()
        expect(page.get_by_text("This is an older version.")).to_have_count(0)
        page.go_back()
        expect(page.get_by_text("This is an older version.")).to_be_visible()
        expect(page.get_by_role("heading", name="ball")).to_be_visible()


def test_an_address_that_is_changed_by_hand_is_followed(place: Place, browser: Browser) -> None:
    ball, mug = (_object(place, place.scene_id, name) for name in ("ball", "mug"))
    with visiting(browser, place.url, f"#/scenes/{place.scene_id}?q=mug&objects={ball}") as visit:
        page = visit.page
        expect(page.locator("canvas")).to_have_attribute("data-shown", re.compile("answer$"))
        visit.tab("Objects")
        expect(page.get_by_role("heading", name="ball")).to_be_visible()
        page.goto(f"{place.url}/#/scenes/{place.scene_id}?q=submarine&view={_VIEW}&objects={mug}")
        expect(page.get_by_role("searchbox")).to_have_value("submarine")
        expect(page.get_by_text("Not here")).to_be_visible()
        visit.tab("Objects")
        expect(page.get_by_role("heading", name="mug")).to_be_visible()
        visit.at_rest()
        assert f"view={_VIEW}" in page.url
        page.goto(f"{place.url}/#/scenes/{place.scene_id}")
        expect(page.get_by_role("heading", name="mug")).to_have_count(0)
        visit.tab("Ask")
        expect(page.get_by_role("searchbox")).to_have_value("")


def test_a_question_on_its_way_does_not_bring_back_the_address_that_was_left(place: Place, browser: Browser) -> None:
    with visiting(browser, place.url, f"#/scenes/{place.scene_id}") as visit:
        page = visit.page
        visit.expected.append("ERR_ABORTED")
        visit.scene_shown()
        page.get_by_role("searchbox").fill("mug")
        page.keyboard.press("Enter")
        page.get_by_role("link", name="Scenes").click()
        expect(page.get_by_role("heading", name="Scenes")).to_be_visible()
        visit.at_rest()
        assert page.url == f"{place.url}/#/"


def test_a_change_before_the_browser_tells_of_the_new_address_does_not_bring_back_the_old_one(
    place: Place, browser: Browser
) -> None:
    with visiting(browser, place.url, f"#/scenes/{place.scene_id}") as visit:
        page = visit.page
        visit.scene_shown()
        objects = visit.tab("Objects")
        # One script, so that the browser's own event comes after the click.
        objects.get_by_role("button", name="ball").evaluate("object => { location.hash = '#/'; object.click(); }")
        expect(page.get_by_role("heading", name="Scenes")).to_be_visible()
        assert page.url == f"{place.url}/#/"


def test_an_address_outlives_signing_in(guarded: Place, browser: Browser) -> None:
    with visiting(browser, guarded.url, f"#/scenes/{guarded.scene_id}?q=mug&view={_VIEW}") as visit:
        visit.sign_in(guarded.new_key("admin"))
        _expect_all(visit.page, "mug", "Objects", _VIEW)


def test_the_content_can_be_skipped_to_and_the_address_stays(place: Place, browser: Browser) -> None:
    with visiting(browser, place.url, "#/server") as visit:
        page = visit.page
        expect(page.get_by_role("heading", name="Jobs")).to_be_visible()
        page.keyboard.press("Tab")
        expect(page.get_by_role("link", name="Skip to the content")).to_be_focused()
        page.keyboard.press("Enter")
        expect(page.get_by_role("main")).to_be_focused()
        page.evaluate("location.hash = '#content'")  # as a tool or a bookmark of the link goes there
        expect(page).to_have_url(f"{place.url}/#/server")
        expect(page.get_by_role("heading", name="Jobs")).to_be_visible()
