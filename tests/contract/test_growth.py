"""A scalar more on a box or on an answer: the type says so, and everything else follows."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from protos.registry import Registry
from tests.copied_sources import copy_sources, insert, run_python

_BOX = '    size: Annotated[Vector3, Field(description="whole edge lengths along the box\'s axes, scene units")]'
_ANSWER = '    version: Annotated[str, Field(description="of the scene")]'
_TRY = """
from fastsplat_contract.codec.json_codec import from_json, to_json
from fastsplat_contract.messages.pieces import answers_of, messages_of
from fastsplat_contract.geometry.poses import Box, Pose, Quaternion, Vector3
from fastsplat_contract.codec.proto_codec import from_proto, to_proto
from fastsplat_contract.messages.queries import Answer

box = Box(Pose(Vector3(0, 0, 0), Quaternion(0, 0, 0, 1)), Vector3(1, 1, 1), 0.75)
assert from_json(Box, to_json(box)) == box == from_proto(Box, to_proto(box))
assert b'"fill":0.75' in to_json(box) and to_proto(box).fill == 0.75
answer = Answer("s", "mug", None, (), None, "1", 0.5, 9, 0, (), ())
assert answer.seconds == 0.5
assert from_json(Answer, to_json(answer)) == answer
assert list(answers_of(messages_of(answer), frozenset())) == [answer]
"""


@pytest.fixture
def grown(tmp_path: Path) -> Path:
    """A copy of the contract in which `Box.fill` and `Answer.seconds` are new on the type."""
    copy_sources(tmp_path, "client", "protos")
    insert(tmp_path / "client/fastsplat_contract/geometry/poses.py", _BOX, "    fill: float")
    insert(tmp_path / "client/fastsplat_contract/messages/queries.py", _ANSWER, "    seconds: float")
    return tmp_path


def test_a_scalar_more_takes_the_type_alone(grown: Path) -> None:
    numbers = grown / "protos/fastsplat/v1/numbers.json"
    before = json.loads(numbers.read_text())
    run_python(grown, "-m", "protos.generate")
    after = json.loads(numbers.read_text())
    assert after["Box"].pop("fill") == 3 and after["Answer"].pop("seconds") == max(before["Answer"].values()) + 1
    assert after == before
    run_python(grown, "-c", _TRY)


def test_a_number_is_given_once_and_never_again(tmp_path: Path) -> None:
    path = tmp_path / "numbers.json"
    path.write_text('{"Box": {"center": 1, "size": 4}}')
    registry = Registry(path)
    assert registry.numbers("Box", ["fill", "size"]) == {"size": 4, "fill": 5}  # `center` went
    assert registry.retired("Box", ["fill", "size"]) == {"center": 1}
    registry.save()
    again = Registry(path)
    assert again.numbers("Box", ["weight", "center"]) == {"center": 1, "weight": 6}
    assert again.numbers("Cone", ["height"]) == {"height": 1}


def test_what_is_gone_from_a_type_is_reserved_in_the_proto(grown: Path) -> None:
    poses = grown / "client/fastsplat_contract/geometry/poses.py"
    poses.write_text(poses.read_text().replace(f"{_BOX}\n", ""))
    run_python(grown, "-c", "from protos import generate; generate.write_proto()")
    proto = (grown / "protos/fastsplat/v1/fastsplat.proto").read_text()
    (box,) = re.findall(r"^message Box \{.*?^\}", proto, re.MULTILINE | re.DOTALL)
    assert "reserved 2;" in box and 'reserved "size";' in box and "double fill = 3;" in box
