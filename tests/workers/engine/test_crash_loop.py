"""Kills at random: workers, trainers and the API, while jobs come in. All that was acknowledged is done once."""

from __future__ import annotations

import os
import random
import signal
import time
from contextlib import suppress
from functools import partial

import httpx

from fastsplat.workers.engine.cleanup import remove_unneeded
from tests.workers.deployment import STAGES, Deployment, children, kill, on_both_databases

_KILLS = 9  # on each database
_JOBS = 10
_SHORTEST_S, _LONGEST_S = 0.05, 1.2


@on_both_databases()
def test_kills_at_random_lose_nothing_and_leave_nothing(deployment: Deployment) -> None:
    seed = int(os.environ.get("FASTSPLAT_TEST_SEED", "") or random.SystemRandom().randrange(2**32))
    print(f"FASTSPLAT_TEST_SEED={seed}")  # shown when the test fails
    loop = _Loop(deployment, random.Random(seed))

    for number in range(_KILLS):
        loop.post_some(number)
        time.sleep(loop.random.uniform(_SHORTEST_S, _LONGEST_S))
        loop.kill_one()
    loop.post_some(_JOBS)
    loop.finish()

    operations = [deployment.service.get_operation(operation_id) for operation_id in loop.acknowledged.values()]
    assert len(operations) == _JOBS
    for operation in operations:
        over = deployment.wait_over(operation)
        assert over.state == "SUCCEEDED", over
        scene = deployment.service.get_scene(operation.scene_id)
        folder = deployment.service._store.blobs.version(scene.id, scene.version)
        assert scene.state == "READY" and {path.name for path in folder.iterdir()} >= {"artefact", "scene.ply"}
        # Stages that a crash cut off ran again; nothing ran beside itself, and nothing after its end.
        path = [visit for stage in STAGES for visit in deployment.visits(stage, operation)]
        attempts = [visit.attempt for visit in path]
        assert {visit.stage for visit in path} == set(STAGES) and attempts == sorted(attempts)
    page, token = deployment.service.list_scenes()
    assert {scene.id for scene in page} == {operation.scene_id for operation in operations} and not token
    assert set(deployment.service._store.blobs.ids("scenes")) == {operation.scene_id for operation in operations}
    store = deployment.service._store
    remove_unneeded(store, upload_expiry_s=-1, ended_job_retention_s=3600, failed_upload_retention_s=-1)
    deployment.wait_for(lambda: deployment.left_over() == [])


class _Loop:
    """Two workers and an API that somebody starts again whenever they die; a client that repeats what failed."""

    def __init__(self, deployment: Deployment, random: random.Random) -> None:
        self.random = random
        self.acknowledged: dict[str, str] = {}
        self._house = deployment
        deployment.max_starts = 1000  # here nobody is to blame
        self._api = deployment.start_api()
        self._workers = [deployment.start_worker() for _ in range(2)]

    def post_some(self, number: int) -> None:
        """Have as many jobs acknowledged as should be by now; a lost answer is asked for again."""
        while len(self.acknowledged) < min(_JOBS, 2 + number):
            request_id = f"job{len(self.acknowledged)}"
            order = f"{self.random.choice(['capture', 'training', 'export'])}:sleep {self.random.uniform(0, 0.5):.2f}"
            self._house.wait_for(partial(self._post, request_id, order))

    def kill_one(self) -> None:
        """kill -9 one process, or all workers; what died starts again."""
        victim = self.random.choice(["worker", "worker", "trainer", "trainer", "api", "workers"])
        if victim == "trainer":
            trainers = [pid for worker in self._workers for pid in children(worker.pid)]
            if trainers:
                with suppress(ProcessLookupError):
                    os.kill(self.random.choice(trainers), signal.SIGKILL)
        elif victim == "api":
            kill(self._api)
        else:
            kill(*(self._workers if victim == "workers" else [self.random.choice(self._workers)]))
        self.finish()

    def finish(self) -> None:
        """Start again what is dead."""
        if self._api.poll() is not None:
            self._api = self._house.start_api(wait=False)
        for number, worker in enumerate(self._workers):
            if worker.poll() is not None:
                self._workers[number] = self._house.start_worker()

    def _post(self, request_id: str, order: str) -> bool:
        try:
            self.acknowledged[request_id] = self._house.post_over_http(order, request_id=request_id)
        except httpx.TransportError:
            return False
        return True
