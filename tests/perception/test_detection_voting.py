"""The views together decide what is in the scene, and which of two rivals an object is."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from fastsplat.service.common.dictionary import label_key
from fastsplat.service.perception.box_ops import box_iou, nms
from fastsplat.service.perception.label_maps.detection_voting import (
    SAME_LABEL_IOU,
    merge_spellings,
    region_votes,
    resolve_detections,
)
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.results import Detections

_SETTINGS = PerceptionSettings()
_BOX, _ASIDE = (10, 10, 50, 50), (100, 100, 140, 140)


def _view(*rows: tuple[str, float, tuple[float, ...]]) -> Detections:
    boxes = np.array([box for _, _, box in rows], np.float32).reshape(-1, 4)
    return Detections(boxes, np.array([s for _, s, _ in rows], np.float32), tuple(n for n, _, _ in rows))


_views = st.lists(
    st.lists(
        st.tuples(
            st.sampled_from(["cup", "mug", "bed", "doll"]),
            st.floats(0.3125, 1, width=32),
            st.tuples(*[st.integers(0, 40)] * 2, *[st.integers(41, 80)] * 2),
        ),
        max_size=5,
    ).map(lambda rows: _view(*rows)),
    min_size=1,
    max_size=6,
)


def test_spellings_of_one_object_get_one_name() -> None:
    views = [_view(("Cups", 0.9, _BOX)), _view(("cup", 0.9, _BOX), ("TEDDY_BEAR", 0.5, _ASIDE))]
    assert [view.labels for view in merge_spellings(views)] == [("Cups",), ("Cups", "TEDDY_BEAR")]
    named = merge_spellings(views, ["teddy bears", "CUP"])
    assert [view.labels for view in named] == [("CUP",), ("CUP", "teddy bears")]


def test_a_flicker_is_dropped_and_a_named_one_kept() -> None:
    views = [_view(("bed", 0.9, _BOX)) for _ in range(20)]
    views[7] = _view(("bed", 0.9, _BOX), ("boat", 0.9, _ASIDE))
    resolved, _ = resolve_detections(views, _SETTINGS, named=False)
    assert {label for view in resolved for label in view.labels} == {"bed"}
    resolved, _ = resolve_detections(views, _SETTINGS, named=True)
    assert {label for view in resolved for label in view.labels} == {"bed", "boat"}


def test_one_view_suffices_where_there_is_one() -> None:
    resolved, _ = resolve_detections([_view(("bed", 0.9, _BOX))], _SETTINGS, named=False)
    assert resolved[0].labels == ("bed",)


def test_weak_sightings_count_once_the_kind_is_believed() -> None:
    weak = _SETTINGS.score_floor + 0.01
    views = [
        _view(("doll", 0.9, _BOX)),
        _view(("doll", 0.9, _BOX)),
        _view(("doll", weak, _BOX), ("oven", weak, _ASIDE)),
    ]
    resolved, _ = resolve_detections(views, _SETTINGS, named=False)
    assert [view.labels for view in resolved] == [("doll",)] * 3


def test_rivals_for_a_box_are_settled_by_all_views() -> None:
    """A bed that looks more like a cake in two of ten photos stays a bed."""
    views = [_view(("bed", 0.8, _BOX)) for _ in range(8)]
    views += [_view(("bed", 0.6, _BOX), ("cake", 0.7, _BOX)) for _ in range(2)]
    resolved, _ = resolve_detections(views, _SETTINGS, named=False)
    assert all(view.labels == ("bed",) for view in resolved)


def test_objects_apart_are_no_rivals() -> None:
    views = [_view(("bed", 0.8, _BOX), ("cake", 0.7, _ASIDE), ("bed", 0.6, (11, 10, 50, 50)))] * 3
    resolved, support = resolve_detections(views, _SETTINGS, named=False)
    assert all(sorted(view.labels) == ["bed", "cake"] for view in resolved)
    np.testing.assert_allclose([support["bed"], support["cake"]], [0.8, 0.7], atol=1e-6)


@given(_views, st.booleans())
def test_what_is_resolved_was_detected_and_stays(views: list[Detections], named: bool) -> None:
    resolved, _ = resolve_detections(views, _SETTINGS, named=named)
    assert len(resolved) == len(views)
    for before, after in zip(views, resolved, strict=True):
        rows = {(label, *box) for label, box in zip(before.labels, before.boxes.tolist(), strict=True)}
        assert {(label, *box) for label, box in zip(after.labels, after.boxes.tolist(), strict=True)} <= rows
    classes = {label for view in resolved for label in view.labels}
    again, _ = resolve_detections(resolved, _SETTINGS, named=named)
    assert {label for view in again for label in view.labels} == classes


@given(_views)
def test_no_two_boxes_for_one_object_are_left(views: list[Detections]) -> None:
    for view in resolve_detections(views, _SETTINGS, named=True)[0]:
        overlap = box_iou(view.boxes, view.boxes)
        for i in range(len(view)):
            for j in range(i):
                same = view.labels[i] == view.labels[j]
                assert overlap[i, j] <= (SAME_LABEL_IOU if same else _SETTINGS.rival_iou)


@given(st.lists(st.sampled_from(["Cup", "cups", "CUP ", "doll", "Dolls", "sofa"]), min_size=1, max_size=8))
def test_names_are_as_many_as_keys(names: list[str]) -> None:
    view = _view(*[(name, 0.9, _BOX) for name in names])
    (named,) = merge_spellings([view])
    assert len(set(named.labels)) == len({label_key(name) for name in names})
    assert [label_key(name) for name in named.labels] == [label_key(name) for name in names]


@given(_views.map(lambda views: views[0]), st.floats(0.1, 0.9))
def test_suppression_keeps_the_best_and_covers_the_rest(view: Detections, iou: float) -> None:
    winners = nms(view.boxes, view.scores, iou)
    overlap = box_iou(view.boxes, view.boxes)
    for row in set(range(len(view))) - set(winners.tolist()):
        assert any(overlap[row, k] > iou and view.scores[k] >= view.scores[row] for k in winners)
    assert list(view.scores[winners]) == sorted(view.scores[winners], reverse=True)


def test_what_an_object_was_also_called_in_its_place_is_a_vote() -> None:
    ids = {"cup": 1, "mug": 2, "bed": 3}
    near = (11, 10, 50, 50)
    likely = _view(
        ("cup", 0.5, _BOX), ("mug", 0.75, near), ("mug", 0.25, _BOX), ("bed", 0.9, _ASIDE), ("doll", 1, _BOX)
    )
    assert region_votes(likely.take([0, 3]), likely, ids, 0.7) == [{1: 0.5, 2: 0.75}, {3: np.float32(0.9)}]
    assert region_votes(likely.take([]), likely, ids, 0.7) == []
