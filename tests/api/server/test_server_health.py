"""The status tells operators alone whether workers live, how long jobs wait, and how much room the disk has."""

from __future__ import annotations

import shutil
import time
from dataclasses import replace
from pathlib import Path

import pytest
from sqlalchemy import update

from fastsplat.cli.operating.status import _facts
from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.settings import Settings
from fastsplat.service.store.rows.database import transaction
from fastsplat.service.store.rows.schema import operations, workers
from fastsplat_contract.server.server_status import ServerHealth
from tests.scenes import queued_job


def _health(service: SceneService) -> ServerHealth:
    health = service.status("operator", "").health
    assert health is not None
    return health


@pytest.fixture
def settings(tmp_path: Path) -> Settings:
    (tmp_path / "models").mkdir()
    return Settings(data_dir=tmp_path / "data", models=tmp_path / "models", auth="off")


def test_it_is_told_to_operators_alone(settings: Settings) -> None:
    with open_service(settings) as service:
        for role in ("admin", "editor", "reader", "uploader", "suggester"):
            assert service.status(role, "").health is None, role
        assert _health(service).workers == ()


def test_a_worker_that_fell_silent_is_named_and_one_that_stopped_is_not(settings: Settings) -> None:
    ages = {"lives": 1.0, "silent": settings.jobs.stalled_worker_timeout_s + 60, "stopped": None}
    with open_service(settings) as service:
        for pid, (name, age) in enumerate(ages.items()):
            service._store.workers.update_heartbeat(name, "machine", pid)
            heard = 0.0 if age is None else time.time() - age
            with transaction(service._store.engine) as connection:
                connection.execute(update(workers).where(workers.c.executor_id == name).values(heartbeat_at=heard))
        status = service.status("operator", "")
        worker_list = _health(service).workers
    assert status.workers == 1
    assert [(worker.pid, worker.alive) for worker in worker_list] == [(0, True), (1, False)]
    assert all(worker.silent_s >= age for worker, age in zip(worker_list, (1.0, ages["silent"]), strict=True) if age)
    assert "silent for" in _facts(status) and "process 1 of machine" in _facts(status)


def test_the_queue_says_how_many_wait_and_since_when(settings: Settings) -> None:
    with open_service(settings) as service:
        store = service._store
        assert (_health(service).queue.waiting, _health(service).queue.waits_s) == (0, None)
        jobs = [queued_job() for _ in range(3)]
        for job, age in zip(jobs, (10.0, 500.0, 90.0), strict=True):
            store.scenes.create(job)
            with transaction(store.engine) as connection:
                mine = operations.c.id == job.operation_id
                connection.execute(update(operations).where(mine).values(updated_at=time.time() - age))
        queue = _health(service).queue
        assert (queue.waiting, queue.running) == (3, 0) and queue.waits_s is not None and 500 <= queue.waits_s < 5_000
        assert store.jobs.claim(jobs[1].operation_id) is not None  # the one that waits longest
        queue = _health(service).queue
        assert (queue.waiting, queue.running) == (2, 1) and queue.waits_s is not None and 90 <= queue.waits_s < 500


def test_the_disk_is_that_of_the_data_folder_with_the_bound_that_uploads_have(settings: Settings) -> None:
    with open_service(settings) as service:
        disk = _health(service).disk
        status = service.status("operator", "")
    assert disk.total_bytes == shutil.disk_usage(settings.data_dir).total
    assert 0 < disk.free_bytes <= disk.total_bytes
    assert disk.floor_bytes == min(settings.uploads.min_free_bytes, disk.total_bytes // 20)
    assert status.health is not None
    for free, said in ((disk.floor_bytes - 1, "are refused"), (disk.floor_bytes, "stop below")):
        health = replace(status.health, disk=replace(disk, free_bytes=free))
        assert said in _facts(replace(status, health=health))
