"""One command puts models to use: a server and a worker that run follow it, and go back, without a variable."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fastsplat.service.jobs import detector_calibration
from fastsplat.service.settings import load_settings
from fastsplat_client import Client
from fastsplat_contract.errors import InvalidInputError, ModelUnavailableError
from fastsplat_contract.jobs.operations import SceneOptions
from fastsplat_contract.messages.queries import QueryRequest
from release.check_wheels import free_ports
from tests.commands import invoke
from tests.hub import FIRST, WORD, Hub, planted_hub, serving_hub
from tests.small_tabletop import small_tabletop
from tests.waiting import wait_for
from tests.workers.deployment import Deployment, answers, real_worker

_CHOICE = {"open_set_detector": {"name": "grounding_dino:elsewhere", "sha256": {"model.onnx": "0" * 64}}}


@pytest.fixture
def place(tmp_path: Path, models_dir: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Client, Hub, Path]]:
    """A server and a worker, as processes, with the default models; a client; a hub and a manifest of its models."""
    for name in ("minilm_l6_int8", "mobile_sam", "picodet_416"):
        (tmp_path / "models").mkdir(exist_ok=True)
        (tmp_path / "models" / name).symlink_to(models_dir / name)
    (port,) = free_ports(1)
    variables = {
        "DATA_DIR": tmp_path / "data", "MODELS": tmp_path / "models", "AUTH": "off", "HTTP_PORT": port, "GRPC_PORT": 0,
        "METRICS_PORT": 0,
    }  # fmt: skip
    for name, value in variables.items():
        monkeypatch.setenv(f"FASTSPLAT_{name}", str(value))
    rooms = tuple(islice(detector_calibration.drawn_rooms(), 2))  # enough for a detector that knows none of them
    monkeypatch.setattr(detector_calibration, "drawn_rooms", lambda: rooms)
    load_settings.cache_clear()
    training = json.dumps({"iterations": 300, "max_side": 120})
    hub, manifest = planted_hub(tmp_path / "made")
    url = f"http://127.0.0.1:{port}"
    api = subprocess.Popen([sys.executable, "-m", "fastsplat.cli.main", "api"], start_new_session=True)
    try:
        wait_for(lambda: answers(f"{url}/livez"))
        with real_worker(load_settings(), TRAINING=training), serving_hub(hub), Client(url, timeout_s=120) as client:
            yield client, hub, manifest
    finally:
        api.terminate()
        assert api.wait(timeout=60) == 0
        load_settings.cache_clear()


def _photos(test_data: Path, folder: Path) -> Path:
    """A posed capture that names nothing, with a bread that is green."""
    path = small_tabletop(test_data, folder, 8) / "transforms.json"
    document = json.loads(path.read_text())
    bread = document.pop("labels")["bread"]
    for frame in document["frames"]:
        picture = np.array(Image.open(folder / frame["file_path"]).convert("RGB"))
        picture[np.asarray(Image.open(folder / frame.pop("mask_path"))) == bread] = (30, 180, 40)
        Image.fromarray(picture).save(folder / frame["file_path"])
    path.write_text(json.dumps(document))
    return folder


def _trained(client: Client, photos: Path, *labels: str) -> str:
    order = client.create_scene(photos, options=SceneOptions(labels=labels, max_gaussians=6000))
    done = client.wait(order.id)
    assert done.state == "SUCCEEDED", done.error
    return done.scene_id


def _outcome(client: Client, scene_id: str) -> str:
    (answer,) = client.ask(QueryRequest(scene_id, (WORD,)))
    return answer.outcome


def test_a_word_is_looked_for_once_models_for_it_are_used(
    place: tuple[Client, Hub, Path], test_data: Path, tmp_path: Path
) -> None:
    client, hub, manifest = place
    photos = _photos(test_data, tmp_path / "photos")
    before = _trained(client, photos)
    assert _outcome(client, before) == "cannot_say"
    with pytest.raises(ModelUnavailableError):
        client.look_again(before, WORD)
    hub.cut = "finder/model.onnx"
    failed = invoke("models", "use", "open-vocabulary", "--manifest", str(manifest))
    assert isinstance(failed.exception, ModelUnavailableError) and hub.fetched
    with pytest.raises(InvalidInputError):  # nothing is chosen by half
        client.create_scene(photos, options=SceneOptions(labels=(WORD,)))
    hub.cut = "-"
    used = invoke("models", "use", "open-vocabulary", "--manifest", str(manifest))
    assert used.exit_code == 0 and used.output.count("is not calibrated") == 2, used.output
    assert "MIT" in used.output and FIRST in used.output
    states = {model.role: (model.name, model.state) for model in client.server_status().models}
    assert states["open_set_detector"] == ("grounding_dino:finder", "ready")
    assert states["image_text"] == ("clip:looks", "ready")
    found = client.wait(client.look_again(before, WORD).id)
    assert found.state == "SUCCEEDED", found.error
    after = _trained(client, photos, WORD)
    assert client.scene(after).quality["found_shares"] == {WORD: 0.0}  # the finder is not calibrated
    assert [_outcome(client, scene_id) for scene_id in (before, after)] == ["probably_here"] * 2  # uncalibrated
    assert invoke("models", "use", "default").exit_code == 0
    with pytest.raises(InvalidInputError):
        client.create_scene(photos, options=SceneOptions(labels=(WORD,)))
    assert _outcome(client, _trained(client, photos)) == "cannot_say"


def test_a_worker_leaves_jobs_whose_models_it_lacks_and_a_job_keeps_its_own(tmp_path: Path) -> None:
    deployment, log = Deployment(tmp_path, ""), tmp_path / "worker.log"
    try:
        models = deployment.service._store.models
        logger = "logging.getLogger('fastsplat.workers.engine.worker')"
        logs = f"import logging\n{logger}.addHandler(logging.FileHandler({str(log)!r}))\n"
        worker = deployment.start_worker(code=logs)
        running = deployment.post("training:sleep 2")
        deployment.wait_in("training", running)
        models.choose(_CHOICE)
        left = deployment.post()
        assert deployment.wait_over(running).state == "SUCCEEDED"
        deployment.wait_for(lambda: "grounding_dino:elsewhere" in log.read_text())
        assert deployment.state(left) == "QUEUED"
        models.choose({})
        assert deployment.wait_over(left).state == "SUCCEEDED" and worker.poll() is None
        assert log.read_text().count("are left to other workers") == 1
    finally:
        deployment.close()
