"""Keys on the page: asked for once, remembered until somebody signs out, and never sent again once refused."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser, expect

from fastsplat.service.application.service import open_service
from tests.api.served import serving
from tests.web.browser import Visit, visiting
from tests.web.conftest import page_settings
from tests.web.table import add_table


@pytest.fixture(scope="module")
def guarded(browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, str]]:
    """The address of a server that wants keys, and a key."""
    settings = page_settings(tmp_path_factory.mktemp("guarded"), auth="on")
    with open_service(settings) as service, serving(service, settings) as ports:
        add_table(service, settings)
        yield f"http://127.0.0.1:{ports.http}", service.admin.keys.create("a person", "admin")[1]


def _enter(visit: Visit, key: str) -> None:
    visit.page.get_by_label("Access key").fill(key)
    visit.page.get_by_role("button", name="Sign in").click()


def test_a_key_is_asked_for_and_remembered_until_signed_out(guarded: tuple[str, str], browser: Browser) -> None:
    url, key = guarded
    with visiting(browser, url) as visit:
        visit.expected.append("401")
        expect(visit.page.get_by_text("This server needs an access key.")).to_be_visible()
        expect(visit.page.get_by_label("Access key")).to_be_focused()
        visit.check_accessible()
        _enter(visit, key)
        expect(visit.page.get_by_role("link", name="a table")).to_be_visible()
        visit.page.reload()
        expect(visit.page.get_by_role("link", name="a table")).to_be_visible()
        other = visit.page.context.new_page()
        other.goto(f"{url}/")
        expect(other.get_by_role("link", name="a table")).to_be_visible()
        visit.page.get_by_role("button", name="Sign out").click()
        expect(visit.page.get_by_label("Access key")).to_be_visible()
        visit.page.reload()
        expect(visit.page.get_by_label("Access key")).to_be_visible()


def test_a_wrong_key_is_said_and_not_sent_again(guarded: tuple[str, str], browser: Browser) -> None:
    url, _ = guarded
    with visiting(browser, url) as visit:
        visit.expected.append("401")
        _enter(visit, "fsk_wrong")
        expect(visit.page.get_by_role("alert")).to_contain_text("does not know this key")
        visit.check_accessible()
        before = len(visit.requests)
        visit.page.wait_for_timeout(5_000)  # longer than any of the page's intervals
        assert len(visit.requests) == before


def test_the_page_that_was_asked_for_is_shown_after_signing_in(guarded: tuple[str, str], browser: Browser) -> None:
    url, key = guarded
    with visiting(browser, url, "#/new") as visit:
        visit.expected.append("401")
        _enter(visit, key)
        expect(visit.page.get_by_role("heading", name="New scene")).to_be_visible()
