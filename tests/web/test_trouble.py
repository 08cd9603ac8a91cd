"""What goes wrong behind the page is shown as what it is: a full quota, a worker that dies."""

from __future__ import annotations

import os
import re
import signal
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path

import pytest
from PIL import Image
from playwright.sync_api import Browser, expect

from fastsplat.service.application.service import open_service
from fastsplat.service.settings import QuotaSettings
from fastsplat_contract.operations import Operation, SceneOptions
from tests.api.served import serving
from tests.web.browser import visiting
from tests.web.conftest import page_settings
from tests.workers.deployment import Deployment
from tests.workers.standby import APIS, WORKERS


@pytest.fixture
def deployment(tmp_path: Path) -> Iterator[Deployment]:
    """A data folder with processes of its own; its stages take orders."""
    made = Deployment(tmp_path, "")
    yield made
    made.close()
    WORKERS.close()
    APIS.close()


def test_a_full_quota_is_said_with_its_limit(browser: Browser, tmp_path: Path) -> None:
    settings = page_settings(tmp_path, quotas=QuotaSettings(scenes=1))
    photos = [tmp_path / f"{number}.jpg" for number in range(3)]
    for number, path in enumerate(photos):
        Image.new("RGB", (64, 64), (40 * number, 90, 120)).save(path)
    with open_service(settings) as service, serving(service, settings) as ports:
        with service.new_upload() as upload:
            for path in photos:
                upload.write(path.name, [path.read_bytes()])
            service.create_scene(upload, "the only one", "", SceneOptions())
        with visiting(browser, f"http://127.0.0.1:{ports.http}", "#/new") as visit:
            page = visit.page
            visit.expected += ["429", "403", "413", "507"]
            page.get_by_label("Choose files").set_input_files(photos)
            page.get_by_role("button", name="Upload").click()
            alert = page.get_by_role("alert")
            expect(alert).to_contain_text(re.compile("quota|scenes", re.IGNORECASE))
            expect(alert).to_contain_text("Limit: 1 scenes of one project")
            visit.check_accessible()
        assert len(service.list_scenes().scenes) == 1


def test_a_job_whose_worker_was_killed_goes_on_with_another(browser: Browser, deployment: Deployment) -> None:
    deployment.start_api()
    operation = deployment.post("training:sleep_once 600")
    worker = deployment.start_worker()
    deployment.wait_in("training", operation)
    with visiting(browser, deployment.http, f"#/scenes/{operation.scene_id}") as visit:
        page = visit.page
        expect(page.get_by_role("progressbar").first).to_be_visible()
        os.kill(worker.pid, signal.SIGKILL)
        page.wait_for_timeout(4_000)  # longer than a worker may be silent in this deployment
        assert deployment.state(operation) in ("QUEUED", "RUNNING")
        if "worker" in {field.name for field in fields(Operation)}:  # the server says who works on a job
            expect(
                page.get_by_text(re.compile("no worker|worker .*(silent|heard)", re.IGNORECASE)).first
            ).to_be_visible()
        expect(page.get_by_role("button", name="Cancel the job")).to_be_enabled()
        visit.check_accessible()
        deployment.start_worker()
        expect(page.get_by_role("heading", name="Ask")).to_be_visible(timeout=120_000)
        assert deployment.state(operation) == "SUCCEEDED"


def test_a_job_that_kills_its_workers_fails_and_says_so(browser: Browser, deployment: Deployment) -> None:
    deployment.max_starts = 1
    deployment.start_api()
    operation = deployment.post("training:kill_worker")
    with visiting(browser, deployment.http, f"#/scenes/{operation.scene_id}") as visit:
        page = visit.page
        deployment.start_worker().wait(120)
        deployment.start_worker()
        alert = page.get_by_role("alert")
        expect(alert).to_contain_text("Failed in the stage “Training”.", timeout=120_000)
        expect(alert).to_contain_text(re.compile("died|ended|killed"))
        expect(page.get_by_role("button", name="Try again")).to_be_visible()
        visit.check_accessible()
        assert deployment.state(operation) == "FAILED"
