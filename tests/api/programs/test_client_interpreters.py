"""The client's wheel on every Python that robots have: its tests there, and a talk with a server of this one."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest

from fastsplat.service.application.service import SceneService
from fastsplat_contract.messages.queries import QueryRequest
from tests.api.made_scene import turned
from tests.api.served import Faces
from tests.client.wheel import ROOT, build_wheel, interpreter, make_environment

_TESTS = (
    "client/scripted.py", "client/test_transport.py", "client/test_captures.py", "contract/catalog.py",
    "contract/test_camera.py", "contract/test_codecs.py", "contract/test_errors.py", "contract/test_pieces.py",
    "contract/test_poses.py", "contract/values.py",
)  # fmt: skip
_TALK = """
import json, sys
from fastsplat_client import Client, NotFoundError, PosedCamera, QueryRequest, Subscription
url, scene_id = sys.argv[1:]
told = {}
with Client(url) as client:
    scene = client.scene(scene_id)
    told["labels"] = [row.label for row in client.labels(scene_id)]
    view = scene.cameras[0]
    (answer,) = client.query(scene_id, "mug", cameras=[view], outputs=["mask2d", "mask3d", "objects"])
    (mask,), (object, *_) = answer.masks, answer.objects
    told["answer"] = [answer.outcome, answer.sentence, mask.area, object.id, len(answer.mask3d)]
    told["pixels"] = int(mask.array().sum())
    question = Subscription(QueryRequest(scene_id, ("mug",), outputs=frozenset({"mask2d"})))
    (seen,) = client.stream_query(question, [view])
    told["streamed"] = seen.answers[0].masks[0].area
    try:
        client.scene("none")
    except NotFoundError as error:
        told["refused"] = [error.field, bool(error.request_id)]
    try:
        client.ask(QueryRequest("none", ("mug",)), protocol="gRPC")
    except NotFoundError as error:
        told["refused over gRPC"] = [error.field, bool(error.request_id)]
json.dump(told, sys.stdout)
"""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_wheel(tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="module")
def environments(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """The interpreter of an environment of a version with the client and what its tests need."""

    @cache
    def environment(version: str) -> Path:
        base = interpreter(version)
        if base is None:
            pytest.skip(f"no Python {version} on this machine")
        folder = tmp_path_factory.mktemp(f"python{version}")
        # Ubuntu 24.04 has this Python, and the numpy that messages of ROS 2 Jazzy are compiled for.
        numpy = ["numpy==1.26.*"] if version == "3.12" else []
        return make_environment(base, folder / "venv", wheel, *numpy, "pytest", "hypothesis", pip=False)

    return environment


@pytest.fixture(params=["3.10", "3.12", "3.13"])
def python(request: pytest.FixtureRequest, environments: Callable[[str], Path]) -> Path:
    """Of each version that robots have, beside this one."""
    return environments(request.param)


@pytest.mark.parametrize("version", ["3.10", "3.12", "3.13"])
def test_the_contract_and_the_client_pass_their_tests_on_each_and_with_the_numpy_of_ros(
    environments: Callable[[str], Path], version: str, tmp_path: Path
) -> None:
    for name in _TESTS:
        (tmp_path / "tests" / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / "tests" / name, tmp_path / "tests" / name)
    command = [environments(version), *"-m pytest -q --import-mode=importlib -p no:cacheprovider tests".split()]
    variables = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
    # Where CI is set, hypothesis has no deadlines.
    environment = {**variables, "PYTHONPATH": str(tmp_path), "CONTRACT_EXAMPLES": "2", "CI": "1"}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-2000:]
    assert "skipped" not in done.stdout and " passed" in done.stdout


def test_the_readmes_example_runs_there(python: Path, faces: Faces, scene_id: str, tmp_path: Path) -> None:
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    (example,) = (block.replace('"tea"', '"mug"') for block in blocks if "fastsplat_client" in block)
    url = "http://localhost:8000"
    assert url in example
    (tmp_path / "fastsplat-data").mkdir()
    (tmp_path / "fastsplat-data/key").write_text("any: this server asks for none")
    (tmp_path / "example.py").write_text(example.replace(url, str(faces.rest.base_url)))
    environment = {**os.environ, "SCENE": scene_id}
    command = [python, "-I", "example.py"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith('Here: "mug". [') and "poses dropped" in done.stdout


def test_it_talks_with_a_real_server(python: Path, faces: Faces, service: SceneService, scene_id: str) -> None:
    command = [python, "-I", "-c", _TALK, str(faces.rest.base_url), scene_id]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    outputs = frozenset({"mask2d", "mask3d", "objects"})
    (truth,) = service.answers.query(QueryRequest(scene_id, ("mug",), (turned(0.0),), outputs=outputs)).answers
    assert truth.objects and truth.mask3d
    area = truth.masks[0].area
    assert report["answer"] == [truth.outcome, truth.sentence, area, truth.objects[0].id, len(truth.mask3d)]
    assert report["pixels"] == report["streamed"] == area > 0
    assert report["labels"] == [row.label for row in service.list_labels(scene_id).labels]
    assert report["refused"] == report["refused over gRPC"] == ["scene", True]
