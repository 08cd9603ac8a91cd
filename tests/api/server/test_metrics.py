"""Metrics tell queueing from computing, what was refused, and what the jobs did."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import httpx
from prometheus_client.parser import text_string_to_metric_families

from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.settings import LimitSettings, Settings
from fastsplat_contract.v1 import fastsplat_pb2 as pb
from tests.api.served import Faces, SlowScenes, on_free_ports, served
from tests.scenes import claimed_job, queued_job
from tests.waiting import wait_for


def _figures(faces: Faces) -> dict[tuple[str, str], float]:
    """(sample, first label) to value."""
    text = httpx.get(f"http://127.0.0.1:{faces.ports.metrics}/metrics", timeout=60).text
    return {
        (sample.name, next(iter(sample.labels.values()), "")): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
        if not sample.name.endswith("_bucket")
    }


def test_waiting_and_computing_are_told_apart() -> None:
    slow = SlowScenes()
    with served(slow, on_free_ports(limits=LimitSettings(threads=1))) as faces:
        asking = [threading.Thread(target=lambda: faces.rest.get("/v1/scenes/x")) for _ in range(3)]
        for thread in asking:
            thread.start()
        assert slow.running.acquire(timeout=30)
        wait_for(lambda: _figures(faces)["fastsplat_queued_calls", ""] == 2)
        busy = _figures(faces)
        assert busy["fastsplat_running_calls", ""] == 1
        assert busy["fastsplat_in_flight", "GET /v1/scenes/{scene_id}"] == 3
        time.sleep(0.3)
        slow.release.set()
        for thread in asking:
            thread.join()
        route = "GET /v1/scenes/{scene_id}"
        wait_for(lambda: _figures(faces)["fastsplat_in_flight", route] == 0)
        idle = _figures(faces)
        assert idle["fastsplat_queued_calls", ""] == idle["fastsplat_running_calls", ""] == 0
        assert idle["fastsplat_queue_seconds_count", route] == idle["fastsplat_compute_seconds_count", route] == 3
        assert idle["fastsplat_queue_seconds_sum", route] >= 0.6  # two of them waited
        assert idle["fastsplat_compute_seconds_sum", route] >= 0.3  # one of them held the thread
        assert idle["fastsplat_requests_total", route] == 3


def test_refusals_and_both_faces_are_counted(service: SceneService, api_settings: Settings) -> None:
    settings = api_settings.model_copy(update={"limits": LimitSettings(burst=2, rate_per_s=0.001)})
    with served(service, settings) as faces:
        faces.rpc.ListScenes(pb.ListScenesRequest())
        assert [faces.rest.get("/v1/scenes").status_code for _ in range(2)] == [200, 429]
        figures = _figures(faces)
        assert figures["fastsplat_rejected_total", "RATE_LIMITED"] == 1
        assert figures["fastsplat_requests_total", "/fastsplat.v1.SceneService/ListScenes"] == 1
        assert figures["fastsplat_compute_seconds_count", "/fastsplat.v1.SceneService/ListScenes"] == 1


def test_jobs_and_the_seconds_of_their_stages_are_told(api_settings: Settings, tmp_path: Path) -> None:
    settings = api_settings.model_copy(update={"data_dir": tmp_path})
    with open_service(settings) as service, served(service, settings) as faces:
        store, before = service._store, _figures(faces)
        store.scenes.create(queued_job())
        claim = claimed_job(store)
        stage = {"stage": "TRAIN", "fraction": 1.0, "message": "", "seconds": 12.5, "metrics": {}}
        store.jobs.report(claim, [stage])
        store.jobs.fail(claim, {"kind": "INTERNAL", "reason": "X", "message": "", "stage": "TRAIN", "details": {}})
        for _ in range(2):  # a job is told once, however often somebody looks
            after = _figures(faces)
            assert after["fastsplat_jobs", "FAILED"] - before["fastsplat_jobs", "FAILED"] == 1
            assert after["fastsplat_jobs", "QUEUED"] - before["fastsplat_jobs", "QUEUED"] == 1
        assert after["fastsplat_job_stage_seconds_sum", "TRAIN"] == 12.5
        assert after["fastsplat_job_stage_seconds_count", "TRAIN"] == 1
        assert ("fastsplat_open_scenes", "") in after
