"""Every type of the contract survives JSON and protobuf, and what is no value of it is refused by name."""

from __future__ import annotations

import itertools
import json
import math
from dataclasses import is_dataclass
from functools import cache
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fastsplat_contract.codec.json_codec import from_json, from_plain, path_of, to_json, to_plain
from fastsplat_contract.codec.members import members
from fastsplat_contract.codec.proto_codec import from_proto, message_class, to_proto
from fastsplat_contract.codec.wire import Request
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.geometry.poses import Pose
from fastsplat_contract.messages.pieces import answers_of, messages_of
from fastsplat_contract.messages.queries import Answer, QueryRequest
from fastsplat_contract.photos.pictures import PictureRequest
from fastsplat_contract.v1 import fastsplat_pb2 as pb
from tests.contract.catalog import TYPES
from tests.contract.values import EXAMPLES, JSON_ONLY, values_of

_RANDOM = settings(max_examples=EXAMPLES, suppress_health_check=list(HealthCheck), derandomize=True)
_REQUESTS = [kind for kind in TYPES.values() if issubclass(kind, Request)]


def _same(left: Any, right: Any) -> bool:
    """Equal; poses, which travel as quaternions and are held as matrices, to rounding."""
    if isinstance(left, PosedCamera):
        assert type(right) is PosedCamera and (left.camera, left.name) == (right.camera, right.name)
        size = float(abs(left.world_from_camera).max())
        return bool(abs(left.world_from_camera - right.world_from_camera).max() <= 1e-12 * (1 + size))
    if is_dataclass(left) and not isinstance(left, type):
        return type(left) is type(right) and all(_same(value, vars(right)[name]) for name, value in vars(left).items())
    if isinstance(left, tuple):
        return type(left) is type(right) and len(left) == len(right) and all(map(_same, left, right))
    return bool(left == right)


@pytest.mark.parametrize("name", TYPES)
def test_a_value_survives_json_and_protobuf(name: str) -> None:
    kind = TYPES[name]

    @_RANDOM
    @given(values_of(kind))
    def survives(value: Any) -> None:
        content = to_json(value)
        assert _same(from_json(kind, content), value)
        assert json.loads(content) == to_plain(value)
        if kind not in JSON_ONLY | {Answer}:
            message = message_class(kind).FromString(to_proto(value).SerializeToString())
            assert _same(from_proto(kind, message), value)

    survives()


@_RANDOM
@given(values_of(Answer))
def test_an_answer_survives_protobuf(answer: Answer) -> None:
    outputs = {"objects"} if answer.objects is not None else set()
    sent = [pb.QueryResponse.FromString(message.SerializeToString()) for message in messages_of(answer)]
    (arrived,) = answers_of(sent, outputs)
    assert _same(arrived, answer)


@pytest.mark.parametrize("name", [kind.__name__ for kind in _REQUESTS])
def test_a_request_is_read_strictly(name: str) -> None:
    kind = TYPES[name]

    @_RANDOM
    @given(values_of(kind), st.data())
    def strict(value: Any, data: st.DataObject) -> None:
        plain = to_plain(value)
        with pytest.raises(InvalidInputError) as caught:
            from_plain(kind, {**plain, "more": 1}, "here")
        assert caught.value.field == "here.more"
        leaves = [(path, leaf) for path, leaf in _leaves(plain, ()) if leaf is not None]
        if leaves:
            path, leaf = data.draw(st.sampled_from(leaves))
            with pytest.raises(InvalidInputError) as caught:
                from_plain(kind, _changed(plain, path, _another(leaf)), "here")
            assert caught.value.field == f"here.{path_of(path)}"

    strict()


def _leaves(plain: Any, path: tuple[str | int, ...]) -> Any:
    if isinstance(plain, dict | list):
        for key, value in plain.items() if isinstance(plain, dict) else enumerate(plain):
            yield from _leaves(value, (*path, key))
    else:
        yield path, plain


def _another(leaf: Any) -> Any:
    """Of a type that means the same to a lax reader."""
    if isinstance(leaf, bool):
        return int(leaf)
    if isinstance(leaf, int | float):
        return str(leaf)
    return [leaf]


def _changed(plain: Any, path: tuple[str | int, ...], value: Any) -> Any:
    copy: Any = json.loads(json.dumps(plain))
    inner = copy
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = value
    return copy


@pytest.mark.parametrize("name", [kind.__name__ for kind in _REQUESTS])
def test_what_is_no_number_is_refused_everywhere(name: str) -> None:
    kind = TYPES[name]
    names = [member.name for member in members(kind) if member.kind is float and not member.many]
    for member, number in itertools.product(names, (math.nan, math.inf, -math.inf)):
        for plain in ({member: number}, json.loads(json.dumps({member: number}))):
            with pytest.raises(InvalidInputError) as caught:
                from_plain(kind, {**_least(kind), **plain})
            assert caught.value.field == member


@cache
def _least(kind: Any) -> dict[str, Any]:
    """Something for every field without a default."""
    drawn: dict[str, Any] = {}

    @settings(max_examples=1, derandomize=True, database=None)
    @given(values_of(kind))
    def draw(value: Any) -> None:
        drawn.update(to_plain(value))

    draw()
    return drawn


def test_fields_of_a_later_release_are_passed_over_in_answers() -> None:
    answer = {"position": {"x": 1, "y": 2.5, "z": 3, "t": 0}, "orientation": {"x": 0, "y": 0, "z": 0, "w": 1}, "new": 1}
    assert from_json(Pose, json.dumps(answer)).position == (1.0, 2.5, 3.0)


def test_of_a_choice_one_may_be_sent() -> None:
    with pytest.raises(InvalidInputError, match="camera and view") as caught:
        to_proto(PictureRequest("s", "rgb", view="v", camera=PosedCamera.from_wire(_least_camera())))
    assert caught.value.field == "camera"


def _least_camera() -> Any:
    plain = _least(TYPES["PosedCamera"])
    return from_plain(TYPES["PosedCamera"], plain)


def test_errors_name_the_place_over_both_protocols() -> None:
    request = QueryRequest("s", ("mug",), (PosedCamera.from_wire(_least_camera()),))
    message = to_proto(request)
    message.cameras[0].orientation.w = 2.0
    plain = to_plain(request)
    plain["cameras"][0]["orientation"]["w"] = 2.0
    refused = []
    for read in (lambda: from_proto(QueryRequest, message, "query"), lambda: from_plain(QueryRequest, plain, "query")):
        with pytest.raises(InvalidInputError) as caught:
            read()
        refused.append((caught.value.message, caught.value.details()))
    assert refused[0] == refused[1]
    assert refused[0][1]["field"] == "query.cameras[0].orientation" and "unit quaternion" in refused[0][1]["hint"]


def test_plain_tuples_are_taken_for_vectors() -> None:
    pose: Any = Pose((1, 2, 3), (0, 0, 0, 1))
    assert from_json(Pose, to_json(pose)) == pose == from_proto(Pose, to_proto(pose))
