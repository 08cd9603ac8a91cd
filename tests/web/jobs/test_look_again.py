"""Looking for more names on the page: queued, followed, and refused with the server's hint where it cannot be done."""

from __future__ import annotations

from playwright.sync_api import Browser, expect

from tests.web.browser import PHONE, Visit, visiting
from tests.web.places import MARKUP, Place


def _look(visit: Visit, names: str) -> None:
    visit.tab("Objects").get_by_text("Look for more names").click()
    visit.page.get_by_label("Names, separated by commas").fill(names)
    visit.page.get_by_role("button", name="Look again").click()


def test_names_are_looked_for(place: Place, browser: Browser, scene_id: str) -> None:
    with visiting(browser, place.url, f"#/scenes/{scene_id}", **PHONE) as visit:
        _look(visit, f"trophy, {MARKUP}")
        note = visit.page.locator(".improve [role=status]")
        expect(note).to_contain_text("Waiting for a worker.")
        visit.check_accessible()
        assert visit.fits()
        (job,) = [job for job in place.service.list_operations().operations if job.kind == "look_again"]
        record = place.service._store.scenes.operation(job.id).order
        assert list(record["texts"]) == ["trophy", MARKUP]
        place.service.cancel_operation(job.id)
        expect(note).to_contain_text("It was cancelled.")


def test_a_server_that_cannot_look_says_what_it_lacks(small: Place, browser: Browser) -> None:
    with visiting(browser, small.url, f"#/scenes/{small.new_scene()}", **PHONE) as visit:
        visit.expected.append("409")
        _look(visit, "trophy")
        expect(visit.page.get_by_role("alert")).to_contain_text("no open-set detector", ignore_case=True)
        expect(visit.page.get_by_role("alert")).to_contain_text("FASTSPLAT_PERCEPTION__OPEN_SET_DETECTOR")
        visit.check_accessible()
