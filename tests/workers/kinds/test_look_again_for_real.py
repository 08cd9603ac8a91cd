"""Looking again from the command line, done by a real worker with real models of evaluation weights."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.perception.text.open_text_encoder import open_text_encoder
from fastsplat.service.settings import load_settings
from tests.commands import invoke
from tests.instances.made_table import made_table
from tests.scenes import store_scene

_ROOT = Path(__file__).parent.parent.parent.parent
_PERCEPTION = {
    "open_set_detector": "yolo_world:yolo_world_s",
    "prompt_encoder": "label_table:clip_text_vocab",
    "open_score_threshold": 0.15,
}

# That it looks at one view is no setting of a server.
_WORKER = """
from fastsplat.cli.operating.logs import log_to_stderr
from fastsplat.service.instances.discovery_settings import LookAgainOptions
from fastsplat.service.settings import load_settings
from fastsplat.workers.engine.worker import run
log_to_stderr("worker")
run(load_settings().model_copy(update={"look_again": LookAgainOptions(views=1)}))
"""


@pytest.fixture
def service(tmp_path: Path, models_dir: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[SceneService]:
    """A service and a worker with an open-set detector, which looks at few pictures."""
    if not (models_dir / "yolo_world_s").is_dir():
        pytest.skip("evaluation weights are not there")
    monkeypatch.setenv("FASTSPLAT_DATA_DIR", str(tmp_path / "data"))
    monkeypatch.setenv("FASTSPLAT_MODELS", str(models_dir))
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
