"""Photos on the page: where to stand for the next, and what those of another day show to be gone."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from playwright.sync_api import Browser, expect

from tests.api.scenes.test_observations import add_room, drawn_photos
from tests.web.browser import PHONE, visiting
from tests.web.glow import page_view
from tests.web.places import Place


def test_places_for_the_next_photos_are_listed_drawn_and_flown_to(place: Place, browser: Browser) -> None:
    photos = place.service.photos.next_photos(place.scene_id).photos
    assert photos
    with visiting(browser, place.url, f"#/scenes/{place.scene_id}?view=0_-8_5_0_0_0.2") as visit:
        visit.scene_shown()
        cameras = visit.page.locator(".frusta.hollow [data-next]")
        expect(cameras).to_have_count(0)
        visit.tab("Photos").get_by_text("Where to stand next").click()
        rows = visit.page.locator(".improve li")
        expect(rows).to_have_count(len(photos))
        for number, photo in enumerate(photos):
            expect(rows.nth(number)).to_contain_text(photo.advice)
        expect(cameras).to_have_count(len(photos))
        visit.check_accessible()
        rows.last.get_by_role("button").click()
        expect(visit.page).not_to_have_url(re.compile("view=0_-8_5"))
        assert np.allclose(page_view(visit.page)[:3], photos[-1].camera.world_from_camera[:3, 3], atol=1e-2)
        visit.page.get_by_text("Where to stand next").click()
        expect(cameras).to_have_count(0)


def test_what_is_gone_is_told_shown_and_undone(place: Place, browser: Browser, tmp_path: Path) -> None:
    service, room = place.service, add_room(place.service, place.settings)
    paths = [tmp_path / f"{number}.png" for number in range(3)]
    for path, content in zip(paths, drawn_photos(block=False), strict=True):
        path.write_bytes(content)
    with visiting(browser, place.url, f"#/scenes/{room}", **PHONE) as visit:
        page = visit.page
        visit.tab("Photos").locator("summary", has_text="Compare with today").click()
        compare = page.get_by_role("button", name="Compare", exact=True)
        expect(compare).to_be_disabled()
        page.get_by_label("Photos of today").set_input_files(paths[:1])
        expect(compare).to_be_disabled()
        page.get_by_label("Photos of today").set_input_files(paths)
        compare.click()
        row = page.locator(".observations > li")
        expect(row).to_have_count(1, timeout=60_000)
        expect(page.get_by_text("3 photos are compared.")).to_be_visible()
        (observation,) = service.observations.all(room).observations
        (change,) = observation.changes
        expect(row).to_contain_text(change.sentence)
        expect(row.locator("canvas[data-drawn]")).to_have_count(2)
        pictures = row.locator("canvas").evaluate_all("(all) => all.map((each) => each.toDataURL())")
        assert pictures[0] != pictures[1]
        show = row.get_by_role("button", name="Show in the scene")
        show.click()
        expect(show).to_have_attribute("aria-pressed", "true")
        visit.check_accessible()
        assert visit.fits()
        row.get_by_role("button", name="Undo this comparison").click()
        expect(row).to_have_count(0)
        expect(page.get_by_text("The comparison is undone.")).to_be_visible()
    assert service.observations.all(room).observations == ()
