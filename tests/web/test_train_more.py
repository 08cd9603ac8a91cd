"""A scene trained further on the page: ordered, followed, cancelled."""

from __future__ import annotations

from playwright.sync_api import Browser, expect

from tests.web.browser import visiting
from tests.web.places import Place


def test_a_scene_is_trained_further(place: Place, browser: Browser, own: str) -> None:
    service, address = place.service, f"#/scenes/{own}"
    with visiting(browser, place.url, address, viewport={"width": 390, "height": 844}) as visit:
        visit.tab("Photos").locator("summary", has_text="Train further").click()
        button = visit.page.get_by_role("button", name="Train further", exact=True)
        visit.page.get_by_label("How thoroughly").select_option("draft")
        button.click()
        status = visit.page.locator(".improve [role=status]")
        expect(status).to_contain_text("Waiting for a worker.")
        visit.check_accessible()
        assert visit.fits()
        (job,) = [
            each for each in service.list_operations().operations if each.kind == "train_more" and each.scene_id == own
        ]
        order = service._store.scenes.operation(job.id).order
        assert order["preset"] == "draft"
        visit.page.get_by_role("button", name="Cancel", exact=True).click()
        expect(status).to_contain_text("It was cancelled.")
        assert service.get_operation(job.id).state == "CANCELLED"
