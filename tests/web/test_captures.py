"""Captures of one place on the page: one is put where the other is, both are listed by date, and photos may join."""

from __future__ import annotations

from pathlib import Path

from playwright.sync_api import Browser, expect

from tests.api.test_api_observations import add_room, drawn_photos
from tests.web.browser import visiting
from tests.web.places import Place


def test_a_second_capture_is_put_where_the_first_is_and_listed(place: Place, browser: Browser, tmp_path: Path) -> None:
    service = place.service
    first, second = (add_room(service, place.settings, scale="METRIC") for _ in range(2))
    paths = [tmp_path / f"{number}.png" for number in range(3)]
    for path, content in zip(paths, drawn_photos(block=True), strict=True):
        path.write_bytes(content)
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

        panel.locator("summary", has_text="Compare with today").click()
        page.get_by_label("Photos of today").set_input_files(paths)
        page.get_by_role("button", name="Compare", exact=True).click()
        panel.locator("summary", has_text="More photos of this place").click(timeout=60_000)
        page.get_by_role("button", name="Let them join").click()
        expect(page.locator(".observations [role=status]")).to_contain_text("Waiting for a worker.")
        (job,) = [
            each
            for each in service.list_operations().operations
            if each.kind == "train_more" and each.scene_id == second
        ]
        (observation,) = service.observations.all(second).observations
        assert service._store.scenes.operation(job.id).order["observations"] == [observation.id]
        page.locator(".observations").get_by_role("button", name="Cancel", exact=True).click()

        listed.get_by_role("link").click()
        expect(page).to_have_url(f"{place.url}/#/scenes/{first}")
    for scene_id in (first, second):
        service.delete_scene(scene_id)
