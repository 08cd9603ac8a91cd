"""Captures of one place on the page: one is put where the other is, and both are listed by date."""

from __future__ import annotations

from playwright.sync_api import Browser, expect

from tests.api.test_api_observations import add_room
from tests.web.browser import visiting
from tests.web.places import Place


def test_a_second_capture_is_put_where_the_first_is_and_listed(place: Place, browser: Browser) -> None:
    service = place.service
    first, second = (add_room(service, place.settings, scale="METRIC") for _ in range(2))
    with visiting(browser, place.url, f"#/scenes/{second}", viewport={"width": 390, "height": 844}) as visit:
        page = visit.page
        panel = visit.tab("Photos")
        panel.locator("summary", has_text="Another capture of this place").click()
        align = page.get_by_role("button", name="Put this scene where that one is")
        expect(align).to_be_disabled()
        page.get_by_label("The other scene").select_option(value=first)
        align.click()
        listed = page.get_by_role("list", name="Captures of this place, the newest first").get_by_role("listitem")
        expect(listed).to_have_count(2, timeout=120_000)
        expect(listed.locator("[aria-current]")).to_contain_text("on show")
        assert [each.id for each in service.list_scenes(place=first).scenes] == [second, first]
        visit.check_accessible()
        assert visit.fits()

        listed.get_by_role("link").click()
        expect(page).to_have_url(f"{place.url}/#/scenes/{first}")
    for scene_id in (first, second):
        service.delete_scene(scene_id)
