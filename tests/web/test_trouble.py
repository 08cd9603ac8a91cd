"""What goes wrong behind the page is shown as what it is: a full quota, a worker that dies."""

from __future__ import annotations

import os
import re
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, expect

from tests.web.browser import visiting
from tests.workers.deployment import Deployment
from tests.workers.standby import APIS, WORKERS


@pytest.fixture
def deployment(tmp_path: Path) -> Iterator[Deployment]:
    """A data folder with processes of its own; its stages take orders."""
    deployment = Deployment(tmp_path, "")
    yield deployment
    deployment.close()
    WORKERS.close()
    APIS.close()


def test_a_job_whose_worker_was_killed_goes_on_with_another(browser: Browser, deployment: Deployment) -> None:
    deployment.start_api()
    operation = deployment.post("training:sleep_once 600")
    worker = deployment.start_worker()
    deployment.wait_in("training", operation)
    with visiting(browser, deployment.http, f"#/scenes/{operation.scene_id}") as visit:
        page = visit.page
        visit.expected.append("409")  # the scene of stages that take orders cannot be shown
        expect(page.get_by_role("progressbar").first).to_be_visible()
        os.kill(worker.pid, signal.SIGKILL)
        expect(page.get_by_text(re.compile("no worker|worker .*(silent|heard)", re.IGNORECASE)).first).to_be_visible()
        assert deployment.state(operation) in ("QUEUED", "RUNNING")
        expect(page.get_by_role("button", name="Cancel the job")).to_be_enabled()
        visit.check_accessible()
        deployment.start_worker()
        expect(page.get_by_role("heading", name="Ask")).to_be_visible(timeout=120_000)
        assert deployment.state(operation) == "SUCCEEDED"
