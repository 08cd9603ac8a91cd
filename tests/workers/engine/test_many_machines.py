"""Two servers, three workers, PostgreSQL and S3: whatever goes, acknowledged jobs are done, and all say the same."""

from __future__ import annotations

import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import fsspec
import httpx
import pytest
from moto.moto_server.threaded_moto_server import ThreadedMotoServer

from fastsplat.service.scene.artefact.scene import Gaussians
from fastsplat.service.scene.artefact.scene_files import read_scene
from fastsplat.service.store.artefact_settings import ArtefactSettings
from tests.postgres import PostgresServer
from tests.workers.deployment import STAGES, Deployment, answers, kill

_AWAY_S = 4.0  # the database, and then the store: longer than a worker may be silent (`Deployment`)


class Store:
    """An S3 server that can go away, and comes back at its address with all that it had."""

    def __init__(self, s3: str) -> None:
        """Beside the tests' own at `s3`, whose contents and keys it shares."""
        self._port = 0
        self.start()
        self.url = f"http://127.0.0.1:{self._port}"
        self.bucket = f"b{uuid.uuid4().hex}"
        self.files = fsspec.filesystem("s3", endpoint_url=s3, skip_instance_cache=True, use_listings_cache=False)
        self.files.mkdir(self.bucket)

    def start(self) -> None:
        """Answer, at the port of before."""
        self._server = ThreadedMotoServer(ip_address="127.0.0.1", port=self._port, verbose=False)
        self._server.start()
        self._port = self._server.get_host_and_port()[1]

    def stop(self) -> None:
        """Refuse connections."""
        self._server.stop()


@pytest.fixture
def store(s3: str) -> Iterator[Store]:
    store = Store(s3)
    yield store
    store.stop()


def test_one_of_each_goes_and_every_job_is_done_once(postgres: PostgresServer, store: Store, tmp_path: Path) -> None:
    artefacts = ArtefactSettings(url=f"s3://{store.bucket}/place", endpoint_url=store.url)
    with postgres.database() as url, ExitStack() as opened:
        machines = [
            opened.enter_context(closing(Deployment(tmp_path / name, url, artefacts=artefacts))) for name in "abc"
        ]
        first, second, third = machines
        server = first.start_api(wait=False)
        second.start_api()
        first.wait_for(lambda: answers(f"{first.http}/livez"))
        worker = first.start_worker(elsewhere=True)

        def is_in(stage: str, job: str) -> bool:
            return any(visit.operation_id == job for machine in machines for visit in machine.visits(stage))

        # A worker dies in mid-training, and the server that took the job with it.
        jobs = [first.post_over_http("training:sleep_once 600", request_id="first")]
        first.wait_for(lambda: is_in("training", jobs[0]))
        jobs.append(first.post_over_http(request_id="second"))
        rows = first.service._store.scenes.operation
        first.wait_for(lambda: [row.get("stored") for row in rows(jobs[0]).stages[:2]] == [1, 1])
        kill(worker, server)
        assert [second.post_over_http("training:sleep_once 600", request_id="first")] == jobs[:1]  # sent again
        workers = [machine.start_worker() for machine in (second, third)]
        jobs += [second.post_over_http(f"{stage}:sleep 1") for stage in ("capture", "training", "export")]

        first.wait_for(lambda: any(is_in("capture", job) for job in jobs[2:]))
        postgres.crash()
        time.sleep(_AWAY_S)
        postgres.start()
        jobs.append(_patiently(lambda: second.post_over_http("training:sleep 1")))

        first.wait_for(lambda: is_in("perception", jobs[-1]))
        store.stop()
        time.sleep(_AWAY_S)
        store.start()

        ended = [first.wait_over(first.service.get_operation(job)) for job in jobs]
        assert [(operation.state, operation.error) for operation in ended] == [("SUCCEEDED", None)] * len(jobs)
        assert all(worker.poll() is None for worker in workers)
        assert all(is_in(stage, job) for stage in STAGES for job in jobs)
        visits = [[len(machine.visits(stage, ended[0])) for stage in STAGES] for machine in machines]
        assert sorted(visits) == [[0, 0, 0, 0], [0, 0, 1, 1], [1, 1, 1, 0]]  # finished stages are not made again
        listed = httpx.get(f"{second.http}/v1/scenes", timeout=60).raise_for_status().json()["scenes"]
        assert sorted(scene["id"] for scene in listed) == sorted(operation.scene_id for operation in ended)
        truth = _fetched(first, listed[0])  # a machine without a server, whose folder knew nothing of the scenes
        for scene in listed:
            assert scene["gaussians"] == len(truth[0]) == 5
            assert _fetched(third, scene)[1] == truth[1]
            answer = httpx.get(f"{second.http}/v1/scenes/{scene['id']}/scene.ply", timeout=60)
            assert answer.raise_for_status().content == truth[1]

        first.wait_for(lambda: not store.files.find(f"{store.bucket}/place/uploads"))
        for scene in listed:
            httpx.delete(f"{second.http}/v1/scenes/{scene['id']}", timeout=60).raise_for_status()
        assert store.files.find(store.bucket) == [f"{store.bucket}/place/identity"]


def _fetched(machine: Deployment, scene: dict[str, Any]) -> tuple[Gaussians, bytes]:
    """A scene as a machine gets it of the store, into its own folder: its Gaussians and its PLY file."""
    folder = machine.service._store.blobs.fetch_version(scene["id"], scene["version"])
    assert folder is not None and folder.is_relative_to(machine.settings.data_dir)
    return read_scene(folder / "artefact").gaussians, (folder / "scene.ply").read_bytes()


def _patiently(call: Callable[[], str]) -> str:
    """What a call returns once the server is ready for it again."""
    for _ in range(100):
        try:
            return call()
        except httpx.HTTPStatusError as error:
            if error.response.status_code != 503:
                raise
            time.sleep(0.1)
    raise AssertionError("waited in vain")
