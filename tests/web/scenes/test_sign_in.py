"""Keys on the page: asked for once, remembered until somebody signs out, and never sent again once refused."""

from __future__ import annotations

from playwright.sync_api import Browser, expect

from tests.web.browser import visiting
from tests.web.places import Place


def test_a_key_is_asked_for_and_remembered_until_signed_out(guarded: Place, browser: Browser) -> None:
    key = guarded.new_key("admin")
    with visiting(browser, guarded.url) as visit:
        expect(visit.page.get_by_text("This server needs an access key.")).to_be_visible()
        expect(visit.page.get_by_label("Access key")).to_be_focused()
        visit.check_accessible()
        visit.sign_in(key)
        expect(visit.page.get_by_role("link", name="a table")).to_be_visible()
        visit.page.reload()
        expect(visit.page.get_by_role("link", name="a table")).to_be_visible()
        tab = visit.page.context.new_page()
        tab.goto(f"{guarded.url}/")
        expect(tab.get_by_role("link", name="a table")).to_be_visible()
        visit.page.get_by_role("button", name="Sign out").click()
        expect(tab.get_by_label("Access key")).to_be_visible()  # in all tabs
        visit.page.reload()
        expect(visit.page.get_by_label("Access key")).to_be_visible()


def test_a_wrong_key_is_said_and_not_sent_again(guarded: Place, browser: Browser) -> None:
    with visiting(browser, guarded.url) as visit:
        visit.reload_with_clock()
        visit.sign_in("fsk_wrong")
        expect(visit.page.get_by_role("alert")).to_contain_text("does not know this key")
        visit.check_accessible()
        assert visit.requests_within(60) == []  # longer than any of the page's intervals
