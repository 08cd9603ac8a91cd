"""Looking for more names on the page: queued, followed, and refused with the server's hint where it cannot be done."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser, expect

from fastsplat.service.perception.settings import PerceptionSettings
from tests.api.made_scene import ENCODER
from tests.web.browser import Visit, visiting
from tests.web.conftest import MARKUP, Place, page_settings, place_with


@pytest.fixture(params=["grounding_dino_tiny", ""])
def served_with(
    request: pytest.FixtureRequest, browser: Browser, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[tuple[str, Place]]:
    """The configured open-set detector, a server with it, and a scene."""
    perception = PerceptionSettings(text_encoder=ENCODER, open_set_detector=request.param)
    with place_with(page_settings(tmp_path_factory.mktemp("look"), perception=perception)) as place:
        yield request.param, place


def _look(visit: Visit, names: str) -> None:
    visit.page.get_by_text("Look for more names").click()
    visit.page.get_by_label("Names, separated by commas").fill(names)
    visit.page.get_by_role("button", name="Look again").click()


def test_names_are_looked_for_where_the_server_can(served_with: tuple[str, Place], browser: Browser) -> None:
    detector, place = served_with
    with visiting(browser, place.url, f"#/scenes/{place.scene_id}", viewport={"width": 390, "height": 844}) as visit:
        if not detector:
            visit.expected.append("409")
            _look(visit, "trophy")
            expect(visit.page.get_by_role("alert")).to_contain_text("no open-set detector", ignore_case=True)
            expect(visit.page.get_by_role("alert")).to_contain_text("FASTSPLAT_PERCEPTION__OPEN_SET_DETECTOR")
            visit.check_accessible()
            return
        _look(visit, f"trophy, {MARKUP}")
        note = visit.page.locator(".improve [role=status]")
        expect(note).to_contain_text("Waiting for a worker.")
        visit.check_accessible()
        assert visit.fits()
        (job,) = [each for each in place.service.list_operations().operations if each.kind == "look_again"]
        record = place.service._store.scenes.operation(job.id).look_again
        assert record is not None and list(record["texts"]) == ["trophy", MARKUP]
        place.service.cancel_operation(job.id)
        expect(note).to_contain_text("It was cancelled.")
