"""Where to stand for the next photos, on the page: said in words, drawn as cameras, flown to."""

from __future__ import annotations

import re
from urllib.parse import unquote

import numpy as np
from playwright.sync_api import Browser, expect

from tests.web.browser import visiting
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
        found = re.search(r"view=([^&]+)", unquote(visit.page.url))
        assert found
        view = [float(number) for number in found[1].split("_")]
        assert np.allclose(view[:3], photos[-1].camera.world_from_camera[:3, 3], atol=1e-2)
        visit.page.get_by_text("Where to stand next").click()
        expect(cameras).to_have_count(0)
