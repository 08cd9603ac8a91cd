"""A scene trained further on the page: ordered, followed, cancelled."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser, expect

from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.perception.settings import PerceptionSettings
from tests.api.made_scene import ENCODER
from tests.api.served import serving
from tests.web.browser import visiting
from tests.web.conftest import page_settings
from tests.web.table import add_table


@pytest.fixture
def served(browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, SceneService, str]]:
    settings = page_settings(tmp_path_factory.mktemp("more"), perception=PerceptionSettings(text_encoder=ENCODER))
    with open_service(settings) as service, serving(service, settings) as ports:
        yield f"http://127.0.0.1:{ports.http}", service, add_table(service, settings)


def test_a_scene_is_trained_further(served: tuple[str, SceneService, str], browser: Browser) -> None:
    url, service, scene_id = served
    with visiting(browser, url, f"#/scenes/{scene_id}", viewport={"width": 390, "height": 844}) as visit:
        visit.page.locator("summary", has_text="Train further").click()
        button = visit.page.get_by_role("button", name="Train further", exact=True)
        visit.page.get_by_label("How thoroughly").select_option("draft")
        button.click()
        status = visit.page.locator(".improve [role=status]")
        expect(status).to_contain_text("Waiting for a worker.")
        visit.check_accessible()
        assert visit.fits()
        (job,) = [each for each in service.list_operations().operations if each.kind == "train_more"]
        order = service._store.scenes.operation(job.id).train_more
        assert order is not None and order["preset"] == "draft"
        visit.page.get_by_role("button", name="Cancel", exact=True).click()
        expect(status).to_contain_text("It was cancelled.")
        assert service.get_operation(job.id).state == "CANCELLED"
