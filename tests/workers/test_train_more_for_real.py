"""A finished scene trained further by a real worker with the real stages: killed on the way, and to no avail."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import safetensors
from PIL import Image

from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.capture.photos.scene_photos import photo_folder, write_photos
from fastsplat.service.capture.settings import PhotoSettings
from fastsplat.service.common.progress import silent
from fastsplat.service.pipeline import Provenance, scene_quality
from fastsplat.service.scene.label_evidence import UNIT, evidence_of
from fastsplat.service.scene.scene_files import read_scene
from fastsplat.service.scene.things import thing_rows
from fastsplat.service.scene.types import Scene, Thing, Things
from fastsplat.service.settings import Settings
from fastsplat.service.splatting.checkpoint import read_checkpoint, write_checkpoint
from fastsplat.service.splatting.settings import TrainingSettings
from fastsplat.service.splatting.train import train
from fastsplat.service.store.file_digests import write_digests
from fastsplat_contract.operations import Operation
from fastsplat_contract.train_more_messages import TrainMoreIn
from tests.scenes import labelled_scene, store_scene
from tests.splatting.train.conftest import MakeWorld
from tests.splatting.train.conftest import make_world as make_world
from tests.waiting import wait_for

_ROOT = Path(__file__).parent.parent.parent
_STEPS, _LABELS = 500, ("floor", "ball", "block")
_CHECKPOINTS = "*/checkpoint.*/training.safetensors"
_MARK_S = 1_000.0
"""Seconds that no run of this test takes, written into a checkpoint."""
_TRAINING = TrainingSettings(
    iterations=_STEPS, time_budget_s=None, max_gaussians=400, max_side=64, evaluations=0, checkpoint_every_s=0.0
)

# A checkpoint after every step is no setting of a server.
_WORKER = """
import os
from fastsplat.cli.logs import log_to_stderr
from fastsplat.service.settings import load_settings
from fastsplat.service.splatting.settings import TrainingSettings
from fastsplat.workers.worker_process import run
log_to_stderr("worker")
training = TrainingSettings.model_validate_json(os.environ["TRAINING"])
run(load_settings().model_copy(update={"training": training}))
"""


@pytest.fixture
def service(tmp_path: Path) -> Iterator[SceneService]:
    """A service without a worker."""
    with open_service(Settings(data_dir=tmp_path / "data", training=_TRAINING)) as service:
        yield service


@pytest.fixture
def start_worker(service: SceneService, tmp_path: Path) -> Iterator[Callable[[], subprocess.Popen[bytes]]]:
    """Starts a worker of the service's data folder; those that still run at the end are ended."""
    changes = {"poll_interval_s": 0.1, "stalled_worker_timeout_s": 2.0, "niceness": 0}
    environment = {
        **os.environ,
        "FASTSPLAT_DATA_DIR": str(tmp_path / "data"),
        "TRAINING": _TRAINING.model_dump_json(),
        "FASTSPLAT_JOBS": json.dumps(changes),
    }
    workers: list[subprocess.Popen[bytes]] = []

    def start() -> subprocess.Popen[bytes]:
        workers.append(
            subprocess.Popen([sys.executable, "-c", _WORKER], env=environment, cwd=_ROOT, start_new_session=True)
        )
        return workers[-1]

    yield start
    for worker in workers:
        worker.terminate()
        worker.wait(timeout=60)


@pytest.fixture
def scene_id(service: SceneService, make_world: MakeWorld) -> str:
    """A scene of 100 steps with a thing for each third of its Gaussians, and its eight photos."""
    capture, labelling = make_world(8)
    trained = train(capture, labelling, _TRAINING.model_copy(update={"iterations": 100}), silent)
    count = len(trained.gaussians)
    table = tuple(Thing(i, name, "detected", 0.9) for i, name in enumerate(_LABELS, start=1))
    things = Things(table, evidence_of(np.arange(count), 1 + np.arange(count) % 3, np.full(count, UNIT), count))
    scene = replace(
        labelled_scene(np.zeros((count, 3)), np.ones(count, int), _LABELS),
        gaussians=trained.gaussians,
        head=trained.head,
        cameras=tuple(view.posed for view in capture.views),
        scale="ARBITRARY",
        quality=scene_quality(trained, labelling, capture, Provenance()),
        things=things,
    )
    made = store_scene(service._store, scene)
    folder = service._store.blobs.version(made, "1")
    write_photos(capture, folder, PhotoSettings())
    write_digests(folder)
    return made


def _wait_for(what: Callable[[], object]) -> None:
    deadline = time.monotonic() + 120
    while not what():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.05)


def _over(service: SceneService, operation: Operation) -> Operation:
    _wait_for(lambda: service.get_operation(operation.id).done)
    return service.get_operation(operation.id)


def _read(service: SceneService, scene_id: str, version: str) -> Scene:
    return read_scene(service._store.blobs.version(scene_id, version) / "artefact")


def test_a_killed_worker_costs_no_step_and_the_scene_becomes_better(
    service: SceneService, scene_id: str, start_worker: Callable[[], subprocess.Popen[bytes]], tmp_path: Path
) -> None:
    before = service.get_scene(scene_id)
    operation = service.training.order(scene_id, TrainMoreIn(steps=_STEPS))
    worker = start_worker()
    jobs = tmp_path / "data" / "jobs"
    _wait_for(lambda: list(jobs.glob(_CHECKPOINTS)))
    worker.kill()
    worker.wait(timeout=60)
    time.sleep(0.5)  # its trainer is killed at that moment, but may be writing
    assert service.get_scene(scene_id).version == before.version, "half a training is no version"

    # What the second worker goes on from says so: seconds that nobody has trained.
    (path,) = jobs.glob(_CHECKPOINTS)
    with safetensors.safe_open(path, "pt") as file:
        fingerprint = file.metadata()["fingerprint"]
    checkpoint = read_checkpoint(path.parent, fingerprint)
    assert checkpoint is not None and 0 < checkpoint.iteration < _STEPS
    write_checkpoint(replace(checkpoint, elapsed_s=_MARK_S), path.parent, fingerprint)
    start_worker()
    done = _over(service, operation)
    assert done.state == "SUCCEEDED", done.error
    made = done.train_more
    assert made is not None and made.current and made.steps == _STEPS and made.trained_from == before.version
    assert made.seconds > _MARK_S
    assert made.psnr is not None and made.psnr_before is not None and made.psnr > made.psnr_before + 0.3
    scene = service.get_scene(scene_id)
    assert scene.version == made.version and scene.state == "READY"
    assert scene.quality["psnr"] == pytest.approx(made.psnr) and scene.gaussians == made.gaussians
    old, new = _read(service, scene_id, before.version), _read(service, scene_id, made.version)
    assert old.things is not None and new.things is not None and new.things.table == old.things.table
    assert len(thing_rows(new.things)) == len(new.gaussians) == made.gaussians
    assert [photo.view for photo in service.photos.all(scene_id).photos] == [view.name for view in old.cameras]

    # Trained on other pictures than it is judged by, it gets worse, so that everything stays as it is.
    folder = service._store.blobs.version(scene_id, made.version)
    for photo in photo_folder(folder).glob("*.jpg"):
        if new.cameras[int(photo.stem)].name not in new.quality["held_out_views"]:
            with Image.open(photo) as image:
                size = image.size
            photo.unlink()  # one file with that of the version before
            Image.new("RGB", size, (250, 40, 250)).save(photo)
    write_digests(folder)
    failed = _over(service, service.training.order(scene_id, TrainMoreIn(steps=60)))
    assert failed.state == "FAILED" and failed.error is not None and failed.error.reason == "TRAINING_DIVERGED"
    assert "stays as it is" in failed.error.message and failed.train_more is None
    after = service.get_scene(scene_id)
    assert (after.version, after.state, after.gaussians) == (made.version, "READY", made.gaussians)
    assert after.quality == scene.quality
    assert {version.version for version in service.versions.all(scene_id)} == {before.version, made.version}
    wait_for(lambda: not list(jobs.iterdir()))  # a job is over before its folder is gone
