"""A scalar more on a box or on an answer: the type and the .proto say so, and everything else follows."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

_ROOT = Path(__file__).resolve().parents[2]
_BOX = """    size: Annotated[Vector3, Field(description="whole edge lengths along the box's axes, scene units")]
"""
_ANSWER = """    version: Annotated[str, Field(description="of the scene")]
    gaussians"""
_TRY = """
from fastsplat_contract.json_codec import from_json, to_json
from fastsplat_contract.pieces import answers_of, messages_of
from fastsplat_contract.poses import Pose, Quaternion, Vector3
from fastsplat_contract.proto_codec import from_proto, to_proto
from fastsplat_contract.queries import Answer
from fastsplat_contract.scenes import Box

box = Box(Pose(Vector3(0, 0, 0), Quaternion(0, 0, 0, 1)), Vector3(1, 1, 1), 0.75)
assert from_json(Box, to_json(box)) == box == from_proto(Box, to_proto(box))
assert b'"fill":0.75' in to_json(box) and to_proto(box).fill == 0.75
answer = Answer("s", "mug", "exact", "", None, (), None, "name", None, "1", 0.5, 9, 0, (), ())
assert answer.seconds == 0.5
assert from_json(Answer, to_json(answer)) == answer
assert list(answers_of(messages_of(answer), frozenset())) == [answer]
"""


@pytest.fixture
def grown(tmp_path: Path) -> Path:
    """A copy of the contract in which `Box.fill` and `Answer.seconds` are new: on the type, and in the .proto."""
    shutil.copytree(_ROOT / "client/fastsplat_contract", tmp_path / "fastsplat_contract")
    shutil.copytree(_ROOT / "protos", tmp_path / "protos")
    _replace(tmp_path / "fastsplat_contract/scenes.py", _BOX, f"{_BOX}    fill: float\n")
    _replace(
        tmp_path / "fastsplat_contract/queries.py",
        _ANSWER,
        _ANSWER.replace("gaussians", "seconds: float\n    gaussians"),
    )
    return tmp_path


def _replace(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert text.count(old) == 1
    path.write_text(text.replace(old, new))


def _run(root: Path, code: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(root)}
    return subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)


def test_a_scalar_more_takes_the_type_and_the_proto(grown: Path) -> None:
    proto = grown / "protos/fastsplat/v1/fastsplat.proto"
    _replace(proto, "message Box {\n", "message Box {\n  double fill = 99;\n")
    _replace(proto, "message Answer {\n", "message Answer {\n  double seconds = 99;\n")
    spec = importlib.util.spec_from_file_location("generate", grown / "protos/generate.py")
    assert spec is not None and spec.loader is not None
    generator = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(generator)
    generator.generate(grown / "fastsplat_contract/v1")
    tried = _run(grown, _TRY)
    assert tried.returncode == 0, tried.stderr


@pytest.mark.parametrize("name", ["Box.fill", "Answer.seconds"])
def test_one_that_the_proto_lacks_is_named(grown: Path, name: str) -> None:
    kind = name.partition(".")[0]
    shutil.copytree(_ROOT / "tests/contract", grown / "tests/contract")
    (grown / "api/rest").mkdir(parents=True)
    shutil.copy(_ROOT / "api/rest/openapi.json", grown / "api/rest/openapi.json")
    for test, words in (
        ("test_protobuf_has_the_same_fields", f"{name} is not in message {kind}"),
        ("test_json_has_the_same_fields", f"openapi.json and the type differ in {name}"),
    ):
        code = f"from tests.contract.test_agreement import {test} as check; check({kind!r})"
        refused = _run(grown, code)
        assert refused.returncode != 0 and words in refused.stderr, refused.stderr
