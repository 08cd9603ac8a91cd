"""Jobs that look again at a finished scene: durable, cancellable, and put into what the scene is when they end."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.text.text_encoders import open_text_encoder
from fastsplat.service.settings import load_settings
from fastsplat.service.store.repositories.version_repository import NewVersion
from fastsplat_contract.jobs.look_again import LookAgainIn
from fastsplat_contract.jobs.operations import Operation
from fastsplat_contract.messages.scenes import SceneVersion
from tests.commands import invoke
from tests.instances.made_table import made_table, measured_detector
from tests.scenes import store_scene
from tests.workers.deployment import Deployment, new_database


@pytest.fixture(scope="module")
def looking(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Deployment]:
    """A deployment whose service lets itself be asked to look again, with a worker that no test ends."""
    deployment = _deployment(tmp_path_factory.mktemp("looking"), "")
    worker = deployment.start_worker()
    yield deployment
    running = worker.poll() is None
    deployment.close()
    assert running


@pytest.fixture
def workerless(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Deployment]:
    """Such a deployment of a test's own, without a worker."""
    with ExitStack() as opened:
        deployment = _deployment(tmp_path, new_database(request, opened))
        yield deployment
        deployment.close()


def _deployment(folder: Path, database_url: str) -> Deployment:
    perception = PerceptionSettings(open_set_detector="grounding_dino_tiny")  # never opened: the stages are fake
    return Deployment(folder, database_url, perception=perception)


def _scene(deployment: Deployment) -> str:
    done = deployment.wait_over(deployment.post())
    assert done.state == "SUCCEEDED" and done.kind == "create_scene" and done.look_again is None
    return done.scene_id


def _look(deployment: Deployment, scene_id: str, *texts: str, request_id: str = "") -> Operation:
    return deployment.service.look_again(scene_id, LookAgainIn(texts, request_id))


def _versions(deployment: Deployment, scene_id: str) -> tuple[SceneVersion, ...]:
    return deployment.service.versions.all(scene_id)


def _edited_elsewhere(deployment: Deployment, scene_id: str, name: str) -> None:
    """Another version of the scene, as an edit would make it current."""
    store = deployment.service._store
    parent = store.scenes.scene(scene_id)
    shutil.copytree(store.blobs.version(scene_id, parent.version), store.blobs.version(scene_id, name))
    store.versions.publish(NewVersion(scene_id, name, parent.version, "", "", 5, parent.dictionary, [], 0))


def test_a_look_makes_a_version_that_is_undone_like_an_edit(looking: Deployment) -> None:
    scene_id = _scene(looking)
    (trained,) = _versions(looking, scene_id)
    queued = _look(looking, scene_id, "trophy", "toy bulldozer", request_id="once")
    assert queued.kind == "look_again" and queued.scene_id == scene_id and not queued.done
    done = looking.wait_over(queued)
    assert done.state == "SUCCEEDED" and [stage.stage for stage in done.stages] == ["looking", "naming"]
    version = _versions(looking, scene_id)[-1]
    assert version.current and version.parent == trained.version
    assert done.look_again is not None and done.look_again.version == version.version
    assert [(edit.action, edit.texts) for edit in version.edits] == [("look_again", ("trophy", "toy bulldozer"))]
    assert looking.service.get_scene(scene_id).dictionary[0].label == "trophy"
    assert _look(looking, scene_id, "trophy", "toy bulldozer", request_id="once").id == queued.id
    assert looking.service.get_scene(scene_id).operation_id != queued.id
    assert looking.service.versions.undo(scene_id).version == trained.version
    assert looking.service.get_scene(scene_id).dictionary[0].label == "mug"
    looking.wait_for(lambda: not looking.left_over(queued))


@pytest.mark.parametrize(
    ("workerless", "order"),
    [
        ("sqlite", "looking:kill_worker"),
        ("sqlite", "looking:kill_once"),
        ("postgresql", "naming:kill_worker_until 1"),  # its last stage writes a version and the job's end at once
    ],
    indirect=["workerless"],
)
def test_a_look_survives_a_killed_worker_or_trainer(workerless: Deployment, order: str) -> None:
    worker = workerless.start_worker()
    scene_id = _scene(workerless)
    order = order.replace("looking:kill_worker", "looking:kill_worker_until 1")
    operation = _look(workerless, scene_id, order)
    if "worker" in order:
        workerless.wait_for(lambda: worker.poll() is not None)
        assert workerless.service.get_scene(scene_id).state == "READY"  # and answers all the while
        workerless.start_worker()
    done = workerless.wait_over(operation)
    assert done.state == "SUCCEEDED" and done.look_again is not None
    assert [version.version for version in _versions(workerless, scene_id)][1:] == [done.look_again.version]
    killed_in = order.partition(":")[0]
    assert len(workerless.visits(killed_in, operation)) >= 2  # more where a busy machine takes a worker for stalled
    workerless.wait_for(lambda: not workerless.left_over())


def test_a_running_look_is_cancelled_and_leaves_nothing(looking: Deployment) -> None:
    scene_id = _scene(looking)
    operation = _look(looking, scene_id, "looking:sleep 60")
    pid = looking.wait_in("looking", operation)
    looking.service.cancel_operation(operation.id)
    done = looking.wait_over(operation)
    assert done.state == "CANCELLED" and done.look_again is None
    looking.wait_for(lambda: not looking.is_alive(pid))
    assert looking.service.get_scene(scene_id).state == "READY" and len(_versions(looking, scene_id)) == 1
    looking.wait_for(lambda: not looking.left_over(operation))


def test_what_was_edited_meanwhile_stays(looking: Deployment) -> None:
    """The names are put into the version that is current when they are written, not into the one that was looked at."""
    scene_id = _scene(looking)
    (trained,) = _versions(looking, scene_id)
    operation = _look(looking, scene_id, "naming:sleep 2")
    looking.wait_in("naming", operation)
    _edited_elsewhere(looking, scene_id, "edited")
    done = looking.wait_over(operation)
    assert done.state == "SUCCEEDED" and done.look_again is not None
    parents = {version.version: version.parent for version in _versions(looking, scene_id)}
    assert parents == {trained.version: "", "edited": trained.version, done.look_again.version: "edited"}
    assert len(looking.visits("looking", operation)) == 1 and len(looking.visits("naming", operation)) == 2


def test_a_deleted_scene_stops_its_looks(looking: Deployment) -> None:
    scene_id = _scene(looking)
    running = _look(looking, scene_id, "looking:sleep 60")
    waiting = _look(looking, scene_id, "trophy", request_id="free-again")
    looking.wait_in("looking", running)
    looking.service.delete_scene(scene_id)
    assert looking.wait_over(running).state == looking.wait_over(waiting).state == "CANCELLED"
    looking.wait_for(lambda: not looking.left_over(running, waiting))
    looking.wait_for(lambda: not (looking.settings.data_dir / "scenes" / scene_id).exists())


def test_a_failed_look_says_why_and_is_retried_without_touching_the_scene(looking: Deployment) -> None:
    scene_id = _scene(looking)
    operation = _look(looking, scene_id, "looking:fail")
    done = looking.wait_over(operation)
    assert done.state == "FAILED" and done.error is not None and done.error.stage == "looking"
    looking.service.retry_operation(operation.id)
    assert looking.service.get_scene(scene_id).state == "READY"
    looking.wait_for(lambda: len(looking.visits("looking", operation)) == 2)
    assert looking.wait_over(operation).state == "FAILED"
    assert looking.service.get_scene(scene_id).state == "READY" and len(_versions(looking, scene_id)) == 1


_ROOT = Path(__file__).parent.parent.parent.parent
_PERCEPTION = {
    "open_set_detector": "yolo_world:yolo_world_s",
    "prompt_encoder": "label_table:clip_text_vocab",
}

# That it looks at one view is no setting of a server.
_WORKER = """
from fastsplat.cli.operating.logs import log_to_stderr
from fastsplat.service.instances.discovery_settings import LookAgainOptions
from fastsplat.service.settings import load_settings
from fastsplat.workers.engine.launchers import run
log_to_stderr("worker")
run(load_settings().model_copy(update={"look_again": LookAgainOptions(views=1)}))
"""


@pytest.fixture
def service(tmp_path: Path, models_dir: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[SceneService]:
    """A service and a worker with an open-set detector, which looks at few pictures."""
    if not (models_dir / "yolo_world_s").is_dir():
        pytest.skip("evaluation weights are not there")
    monkeypatch.setenv("FASTSPLAT_DATA_DIR", str(tmp_path / "data"))
    models = measured_detector(models_dir, tmp_path / "models", _PERCEPTION["open_set_detector"])
    monkeypatch.setenv("FASTSPLAT_MODELS", str(models))
    monkeypatch.setenv("FASTSPLAT_PERCEPTION", json.dumps(_PERCEPTION))
    monkeypatch.setenv("FASTSPLAT_JOBS", json.dumps({"niceness": 0}))  # a busy machine must not keep the test waiting
    load_settings.cache_clear()
    command = [sys.executable, "-c", _WORKER]
    with open_service(load_settings()) as opened:
        worker = subprocess.Popen(command, env=dict(os.environ), cwd=_ROOT, start_new_session=True)
        yield opened
        worker.terminate()
        assert worker.wait(timeout=60) == 0
    load_settings.cache_clear()


def test_a_scene_is_searched_from_the_command_line(service: SceneService, test_data: Path) -> None:
    encoder = open_text_encoder("minilm_l6_int8", load_settings().models)
    scene, truth = made_table(test_data / "tabletop", range(0, 40, 20), encoder)
    scene_id = store_scene(service._store, scene)
    looked = invoke("objects", "look-again", scene_id, "banana", "orange", "--watch", "--json")
    assert looked.exit_code == 0, looked.output
    result = json.loads(looked.stdout)["look_again"]
    assert result["rendered"] and len(result["views"]) == 1 and result["texts"] == ["banana", "orange"]
    assert re.search(r"^looking \d+% ", looked.stderr, re.MULTILINE)
    named = {item["object_id"]: item["name"] for item in result["named"]}
    assert {truth[object_id] for object_id, name in named.items() if truth[object_id] == name} == {"banana", "orange"}
    versions = service.versions.all(scene_id)
    assert [version.version for version in versions] == ["1", result["version"]] and versions[-1].current
    objects = {obj.id: obj for obj in service.answers.list_objects(scene_id).objects}
    assert {obj.id for obj in objects.values() if obj.source == "detected"} == set(named)
    (operation,) = [job for job in service.list_operations().operations if job.kind == "look_again"]
    assert operation.state == "SUCCEEDED" and [stage.stage for stage in operation.stages] == ["looking", "naming"]
    ply = [service._store.blobs.version(scene_id, version.version) / "scene.ply" for version in versions]
    assert ply[0].samefile(ply[1])  # the Gaussians are the same
    service.versions.undo(scene_id)
    assert not any(obj.name for obj in service.answers.list_objects(scene_id).objects)
    unknown = invoke("objects", "look-again", scene_id, "flux capacitor")
    assert unknown.exit_code != 0 and "does not know: flux capacitor" in str(unknown.exception)
