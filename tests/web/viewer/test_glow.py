"""What glows on the page is where the server says that it is; both definitions: `glow.py`."""

from __future__ import annotations

import re

import numpy as np
import pytest
from playwright.sync_api import Browser, expect

from tests.web.browser import visiting
from tests.web.glow import SELECTED, canvas_pixels, glowing, overlap, page_camera, server_mask, server_pixels
from tests.web.places import Place

_VIEWS = ("0.9_-2.6_1.9_0_0_0.2", "-1.7_-2.3_1.1_0_0_0.2", "0.2_-1.9_2.6_0_0_0.2")
_NAMES = ("mug", "ball", "story book")


@pytest.mark.parametrize(("view", "selected_name"), list(zip(_VIEWS, _NAMES, strict=True)))
def test_the_pixels_that_glow_are_the_servers_mask(
    place: Place, webgl_browser: Browser, view: str, selected_name: str
) -> None:
    ids = {obj.name: obj.id for obj in place.service.answers.list_objects(place.scene_id).objects}
    address = f"{place.url}/#/scenes/{place.scene_id}?view={view}"
    with visiting(webgl_browser, place.url, f"#/scenes/{place.scene_id}?view={view}", device_scale_factor=1) as visit:
        page, canvas = visit.page, visit.scene_shown()
        plain = canvas_pixels(page)
        height, width, _ = plain.shape
        posed = page_camera(page, width, height)
        assert np.abs(plain - server_pixels(place, posed) / 255).mean() < 0.01  # the same scene from the same place
        for name in _NAMES:
            mask = server_mask(place, posed, name)
            page.goto(f"{address}&q={name}")
            expect(canvas).to_have_attribute("data-shown", re.compile("answer$"))
            found = overlap(mask, glowing(plain, canvas_pixels(page)))
            assert mask.sum() > 2_000 and found >= 0.95, (name, found)
        page.goto(f"{address}&objects={ids[selected_name]}")
        expect(canvas).to_have_attribute("data-shown", re.compile("plain$"))
        selected = overlap(server_mask(place, posed, selected_name), glowing(plain, canvas_pixels(page), SELECTED))
        assert selected >= 0.95, selected
