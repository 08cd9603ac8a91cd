"""API and workers on machines that share a database and an object store, and no folder."""

from __future__ import annotations

import uuid
from contextlib import closing
from pathlib import Path

import fsspec

from fastsplat.service.scene.scene_files import read_scene
from fastsplat.service.store.settings import ArtefactSettings
from tests.postgres import PostgresServer
from tests.workers.deployment import Deployment, kill


def test_a_job_moves_to_another_machine_and_its_scene_to_all(postgres: PostgresServer, s3: str, tmp_path: Path) -> None:
    bucket = f"b{uuid.uuid4().hex}"
    files = fsspec.filesystem("s3", endpoint_url=s3, skip_instance_cache=True, use_listings_cache=False)
    files.mkdir(bucket)
    artefacts = ArtefactSettings(url=f"s3://{bucket}/place", endpoint_url=s3)
    one, two = tmp_path / "one", tmp_path / "two"
    with (
        postgres.database() as url,
        closing(Deployment(tmp_path / "api", url, artefacts=artefacts)) as deployment,
    ):
        operation = deployment.post("training:sleep_once 600")
        first = deployment.start_worker(elsewhere=True, data_dir=one)
        deployment.wait_for(lambda: deployment.visits("training", operation, one))
        kill(first)
        deployment.start_worker(data_dir=two)
        assert deployment.wait_over(operation).state == "SUCCEEDED"

        assert [len(deployment.visits(stage, operation, two)) for stage in ("capture", "training", "export")] == [
            1,
            1,
            1,
        ]
        scene = deployment.service.get_scene(operation.scene_id)
        folder = deployment.service._store.blobs.fetch_version(scene.id, scene.version)
        assert folder is not None and folder.is_relative_to(deployment.settings.data_dir)
        assert len(read_scene(folder / "artefact").gaussians) == scene.gaussians == 5
        deployment.wait_for(lambda: not files.find(f"{bucket}/place/uploads"))
        deployment.service.delete_scene(scene.id)
        assert files.find(bucket) == [f"{bucket}/place/identity"]
