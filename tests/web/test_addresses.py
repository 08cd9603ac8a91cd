"""What a person looks at has an address: it comes back after a reload, in another browser, and with "back"."""

from __future__ import annotations

import re
from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser, Page, expect

from fastsplat.service.application.service import open_service
from fastsplat_contract.scenes import Edit
from tests.api.served import serving
from tests.web.browser import visiting
from tests.web.conftest import Place, page_settings
from tests.web.table import add_table

_VIEW = "0.9_-2.6_1.9_0_0_0.2"


def _thing(place: Place, scene_id: str, name: str, version: str = "") -> int:
    return next(thing.id for thing in place.service.answers.list_things(scene_id, version).things if thing.name == name)


def _expect_all(page: Page, text: str, selected: str, view: str) -> None:
    expect(page.get_by_role("searchbox")).to_have_value(text)
    expect(page.get_by_text("Here it is")).to_be_visible()
    expect(page.get_by_role("heading", name=selected)).to_be_visible()
    expect(page.locator("canvas")).to_have_attribute("data-shown", re.compile("answer$"))
    page.wait_for_timeout(500)
    assert f"view={view}" in page.url


def test_question_view_and_selection_come_back_here_and_elsewhere(place: Place, browser: Browser) -> None:
    with visiting(browser, place.url, f"#/scenes/{place.scene_id}?view={_VIEW}") as visit:
        page = visit.page
        page.get_by_role("region", name="Things").get_by_role("button", name="ball").click()
        expect(page.get_by_role("heading", name="ball")).to_be_visible()
        page.get_by_role("searchbox").fill("mug")
        expect(page.get_by_text("Here it is")).to_be_visible()
        ball = _thing(place, place.scene_id, "ball")
        expect(page).to_have_url(re.compile(f"q=mug.*view=.*things={ball}$"))
        page.wait_for_timeout(1_000)  # the camera is at rest
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
        expect(page.get_by_role("heading", name="Things")).to_be_visible()
        page.goto(f"{place.url}/#/scenes/{scene_id}?q=mug")  # followed while a version is on show
        expect(page.get_by_text("Here it is")).to_be_visible()
        page.get_by_role("region", name="Things").get_by_role("button", name="ball").click()
        page.get_by_role("searchbox").fill("story book")
        expect(page.get_by_role("button", name="Look at story book 1")).to_be_visible()
        page.get_by_label("Name", exact=True).fill("violin")
        page.get_by_role("button", name="Save the name").click()
        expect(page.get_by_role("heading", name="violin")).to_be_visible()
        page.wait_for_timeout(1_000)
        expect(page.get_by_role("searchbox")).to_have_value("story book")
        expect(page.get_by_role("heading", name="violin")).to_be_visible()
        assert "violin" in {thing.name for thing in place.service.answers.list_things(scene_id).things}
    place.service.delete_scene(scene_id)


def test_an_older_version_has_an_address(place: Place, browser: Browser) -> None:
    scene_id = place.new_scene("versions")
    old = place.service.get_scene(scene_id).version
    ball = _thing(place, scene_id, "ball")
    place.service.versions.edit(scene_id, (Edit("name", things=(ball,), name="violin"),), looked_at=old)
    address = f"#/scenes/{scene_id}?version={old}&things={ball}"
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
    place.service.delete_scene(scene_id)


def test_an_address_that_is_changed_by_hand_is_followed(place: Place, browser: Browser) -> None:
    ball, mug = (_thing(place, place.scene_id, name) for name in ("ball", "mug"))
    with visiting(browser, place.url, f"#/scenes/{place.scene_id}?q=mug&things={ball}") as visit:
        page = visit.page
        expect(page.get_by_role("heading", name="ball")).to_be_visible()
        expect(page.locator("canvas")).to_have_attribute("data-shown", re.compile("answer$"))
        page.goto(f"{place.url}/#/scenes/{place.scene_id}?q=submarine&view={_VIEW}&things={mug}")
        expect(page.get_by_role("searchbox")).to_have_value("submarine")
        expect(page.get_by_text("Not here")).to_be_visible()
        expect(page.get_by_role("heading", name="mug")).to_be_visible()
        page.wait_for_timeout(1_000)
        assert f"view={_VIEW}" in page.url
        page.goto(f"{place.url}/#/scenes/{place.scene_id}")
        expect(page.get_by_role("searchbox")).to_have_value("")
        expect(page.get_by_role("heading", name="mug")).to_have_count(0)


def test_a_question_on_its_way_does_not_bring_back_the_address_that_was_left(place: Place, browser: Browser) -> None:
    with visiting(browser, place.url, f"#/scenes/{place.scene_id}") as visit:
        page = visit.page
        visit.expected.append("ERR_ABORTED")
        expect(page.get_by_role("heading", name="Things")).to_be_visible()
        page.get_by_role("searchbox").fill("mug")
        page.keyboard.press("Enter")
        page.get_by_role("link", name="Scenes").click()
        expect(page.get_by_role("heading", name="Scenes")).to_be_visible()
        page.wait_for_timeout(1_500)
        assert page.url == f"{place.url}/#/"


def test_a_change_before_the_browser_tells_of_the_new_address_does_not_bring_back_the_old_one(
    place: Place, browser: Browser
) -> None:
    with visiting(browser, place.url, f"#/scenes/{place.scene_id}") as visit:
        page = visit.page
        things = page.get_by_role("region", name="Things")
        # One script, so that the browser's own event comes after the click.
        things.get_by_role("button", name="ball").evaluate("thing => { location.hash = '#/'; thing.click(); }")
        expect(page.get_by_role("heading", name="Scenes")).to_be_visible()
        assert page.url == f"{place.url}/#/"


@pytest.fixture(scope="module")
def guarded(browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, str, str]]:
    """The address of a server that wants keys, a key, and a scene."""
    settings = page_settings(tmp_path_factory.mktemp("addresses"), auth="on")
    with open_service(settings) as service, serving(service, settings) as ports:
        key = service.admin.keys.create("a person", "admin")[1]
        yield f"http://127.0.0.1:{ports.http}", key, add_table(service, settings)


def test_an_address_outlives_signing_in_and_signing_out_is_of_all_tabs(
    guarded: tuple[str, str, str], browser: Browser
) -> None:
    url, key, scene_id = guarded
    with visiting(browser, url, f"#/scenes/{scene_id}?q=mug&view={_VIEW}") as visit:
        page = visit.page
        visit.expected.append("401")
        page.get_by_label("Access key").fill(key)
        page.get_by_role("button", name="Sign in").click()
        _expect_all(page, "mug", "Things", _VIEW)
        other = page.context.new_page()
        other.goto(page.url)
        _expect_all(other, "mug", "Things", _VIEW)
        other.get_by_role("button", name="Sign out").click()
        expect(page.get_by_label("Access key")).to_be_visible()
        page.get_by_label("Access key").fill(key)
        page.get_by_role("button", name="Sign in").click()
        _expect_all(page, "mug", "Things", _VIEW)
        _expect_all(other, "mug", "Things", _VIEW)
