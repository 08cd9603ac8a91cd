"""Answers of any size in messages, and together again."""

from __future__ import annotations

from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st

from fastsplat_contract.geometry.poses import Box, Pose, Quaternion, Vector3
from fastsplat_contract.masks import Segmentation, ViewMask
from fastsplat_contract.messages.objects import SceneObject
from fastsplat_contract.messages.pieces import CHUNK_BYTES, answers_of, messages_of
from fastsplat_contract.messages.queries import Answer, Match
from tests.contract.values import EXAMPLES

_GRPC_BYTES = 4 * 2**20
_ALL = frozenset({"mask2d", "mask3d", "objects"})
_POINT = Vector3(1.0, 2.0, 3.0)
_BOX = Box(Pose(_POINT, Quaternion(0.0, 0.0, 0.0, 1.0)), _POINT)
_OBJECT = SceneObject(1, "mug", "detected", 0.5, (), "object", "", 0.75, 60, _BOX, True)


def _answer(**more: Any) -> Answer:
    return Answer(
        scene_id="scene",
        text="mug",
        probability=0.25,
        **{"label_set": (), "matches": (), "masks": (), **more},
        coverage=0.9,
        version="1",
        gaussians=9,
        match_count=7,
    )


@settings(max_examples=min(EXAMPLES, 8))
@given(
    sizes=st.lists(st.integers(0, 3 * CHUNK_BYTES), max_size=3),
    pictures=st.lists(st.integers(1, 3 * CHUNK_BYTES), max_size=2),
    mask3d_bytes=st.integers(0, 3 * CHUNK_BYTES),
    labels=st.sampled_from([0, 1, 100, 30_000]),
    objects=st.sampled_from([0, 1, 20_000]),
)
def test_answers_of_any_size_fit_in_messages_and_come_together_again(
    sizes: list[int], pictures: list[int], mask3d_bytes: int, labels: int, objects: int
) -> None:
    letters = "".join(map(chr, range(48, 112)))
    masks = tuple(
        ViewMask("", n, Segmentation((4, 5), letters * (size // 64)), None, size) for n, size in enumerate(sizes)
    )
    masks += tuple(ViewMask(f"view {size}", 0, None, bytes(size), size) for size in pictures)
    matches = tuple(Match(n, f"{'x' * 150} {n}", 0.75, 0.5, "objects", 60, True, None) for n in range(1, labels + 1))
    answer = _answer(
        label_set=tuple(range(labels)),
        matches=matches,
        masks=masks,
        mask3d=bytes(range(256)) * (mask3d_bytes // 256),
        objects=(_OBJECT,) * objects,
    )
    messages = list(messages_of(answer))
    assert all(message.ByteSize() < _GRPC_BYTES / 2 for message in messages)
    assert list(answers_of(messages, _ALL)) == [answer]


def test_nothing_and_nothing_asked_for_are_told_apart() -> None:
    messages = list(messages_of(_answer()))
    (bare,) = answers_of(messages, frozenset())
    assert bare.mask3d is None and bare.objects is None
    (empty,) = answers_of(messages_of(_answer(mask3d=b"", objects=())), _ALL)
    assert empty.mask3d == b"" and empty.objects == ()


def test_several_answers_stay_apart() -> None:
    several = [_answer(label_set=(number,), mask3d=bytes([number]), objects=(_OBJECT,) * number) for number in range(4)]
    messages = [message for answer in several for message in messages_of(answer)]
    assert list(answers_of(messages, _ALL)) == several
