"""What a detector's scores say of a name, from where a scene is looked at again, and what the votes change."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from fastsplat.service.common.dictionary import label_key
from fastsplat.service.instances.discovery_settings import DiscoverySettings
from fastsplat.service.instances.naming.name_models import (
    HeldOutNames,
    NameCategory,
    NameModel,
    default_name_model,
    load_name_model,
    save_name_model,
)
from fastsplat.service.instances.naming.naming import (
    NAMED_FROM,
    name_evidence,
    name_probability,
)
from fastsplat.service.instances.naming.second_look import (
    NamesAdded,
    add_names,
    best_positions,
    choose_views,
    closer_look,
    mean_votes,
    objects_in_map,
    shares_seen,
    votes_for,
)
from fastsplat.service.perception.results import Detections
from fastsplat.service.scene.artefact.scene import STATED_FROM, Object, Objects
from fastsplat.service.scene.artefact.suggestions import Suggestion
from fastsplat.service.scene.objects.label_evidence import UNIT, evidence_of, no_evidence
from fastsplat_contract.errors import ModelUnavailableError
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from tests.instances.made_room import make_room

_SHARES = hnp.arrays(
    np.float64, st.tuples(st.integers(1, 7), st.integers(1, 5)), elements=st.floats(0, 1, allow_subnormal=False)
)


def _added(obj: Object, texts: dict[str, float]) -> tuple[Object, NamesAdded]:
    added = add_names(Objects((obj,), no_evidence(0)), {obj.id: texts}, name_probability=0.4)
    return added.objects.table[0], added


@given(_SHARES, st.integers(1, 8), st.data())
def test_views_are_chosen_once_best_first_and_until_nothing_is_seen(
    shares: np.ndarray, limit: int, data: st.DataObject
) -> None:
    named = data.draw(st.lists(st.booleans(), min_size=shares.shape[1] - 1, max_size=shares.shape[1] - 1))
    positions = choose_views(shares, named, limit)
    assert len(positions) == len(set(positions)) <= limit
    worth = np.array([*(0.5 if has_name else 1.0 for has_name in named), 1.0])
    sees = (shares @ worth) > 0
    assert set(positions) <= set(np.flatnonzero(sees)) and len(positions) == min(limit, sees.sum())
    if positions:
        assert (shares @ worth)[positions[0]] == pytest.approx((shares @ worth).max())


def test_what_was_not_seen_yet_and_what_has_no_name_goes_before() -> None:
    both, rest, same = [1.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.2], [1.0, 1.0, 0.0, 0.0]
    assert choose_views(np.array([both, rest, same]), [False] * 3, 2) == [0, 1]
    assert choose_views(np.array([[0.9, 0.0, 0.0], [0.0, 0.8, 0.0]]), [True, False], 1) == [1]


def test_a_view_sees_what_nothing_hides(tmp_path: Path) -> None:
    """Of the made room: from above the floor hides nothing, from below it hides all."""
    room = make_room(tmp_path, views=4)
    owner = room.owner.astype(np.int64)
    rows = np.arange(len(owner))
    membership = evidence_of(rows, owner, np.full(len(owner), 16 * UNIT, np.int64), len(owner))
    objects = Objects((Object(1), Object(2), Object(3)), membership)
    below = np.diag([1.0, 1.0, 1.0, 1.0])
    below[2, 3] = -3.0  # looks up along z
    cameras = [view.posed for view in room.capture.views]
    heard: list[tuple[int, int]] = []
    shares = shares_seen(
        room.gaussians,
        objects,
        [*cameras, PosedCamera(cameras[0].camera, below)],
        DiscoverySettings(),
        lambda done, total: heard.append((done, total)),
    )
    assert shares.shape == (5, 4) and heard == [(number, 5) for number in range(1, 6)]
    assert ((shares >= 0) & (shares <= 1)).all()
    assert (shares[:4, :3] > 0.3).all() and (shares[4, :3] < shares[:4, :3].min()).all()
    assert shares[4, 3] > 0.3  # the floor itself


def test_a_clear_text_becomes_the_name_and_an_unsure_one_is_suggested() -> None:
    obj, added = _added(Object(3), {"mug": 0.6, "cup": 0.2})
    assert (obj.name, obj.source, obj.probability) == ("mug", "detected", 0.6)
    assert obj.suggestions == (Suggestion("cup", 0.2),) and added.named == (3,) and added.suggested == ()
    for texts in ({"mug": 0.39}, {"mug": 0.6, "cup": 0.31}):
        obj, added = _added(Object(3, suggestions=(Suggestion("bottle", 0.35),)), texts)
        guesses = {guess.name: guess.probability for guess in obj.suggestions}
        assert obj.name == "" and guesses == {"bottle": 0.35, **texts}
        assert added.named == () and added.suggested == (3,)


@pytest.mark.parametrize("source", ["person", "given"])
def test_names_of_people_and_label_maps_stay(source: str) -> None:
    before = Object(3, "trophy", source, 1.0)
    obj, added = _added(before, {"mug": 1.0})
    assert obj == before and added.named == added.suggested == ()


def test_a_detected_name_gives_way_only_to_a_clear_one() -> None:
    unsure, added = _added(Object(3, "dog", "detected", 0.5), {"mascot doll": 0.7})
    assert unsure.name == "dog" and unsure.suggestions == (Suggestion("mascot doll", 0.7),) and added.suggested == (3,)
    clear, added = _added(Object(3, "dog", "detected", 0.4), {"mascot doll": 0.9})
    assert clear.name == "mascot doll" and clear.suggestions == (Suggestion("dog", 0.4),) and added.named == (3,)
    same, added = _added(Object(3, "dog", "detected", 0.5), {"Dogs": 0.2})
    assert (same.name.lower(), same.probability) == ("dog", 0.5) and added.named == (3,)


def test_what_was_suggested_with_more_is_not_overruled() -> None:
    obj, _ = _added(Object(3, suggestions=(Suggestion("spoon", 0.7),)), {"scissors": 0.6})
    assert obj.name == "" and obj.suggestions == (Suggestion("spoon", 0.7), Suggestion("scissors", 0.6))
    seen_twice, _ = _added(Object(3, suggestions=(Suggestion("scissors", 0.7),)), {"scissors": 0.2})
    assert seen_twice.name == "" and seen_twice.suggestions == (Suggestion("scissors", 0.7),)


@given(
    st.dictionaries(st.sampled_from(["mug", "cup", "bowl", "can"]), st.floats(0, 1), max_size=4),
    st.sampled_from([("", None), ("mug", "detected"), ("jar", "detected"), ("jar", "person"), ("jar", "given")]),
    st.lists(st.tuples(st.sampled_from(["mug", "jar", "vase"]), st.floats(0, 1)), max_size=3, unique_by=lambda p: p[0]),
)
def test_every_object_has_one_name_or_suggestions_and_none_twice(
    texts: dict[str, float], name: tuple[str, str | None], suggestions: list[tuple[str, float]]
) -> None:
    guesses = tuple(Suggestion(*pair) for pair in suggestions if pair[0] != name[0])
    before = Object(1, name[0], name[1], 0.5 if name[0] else 0.0, suggestions=guesses)
    obj, added = _added(before, texts)
    keys = [label_key(pair[0]) for pair in obj.suggestions] + ([label_key(obj.name)] if obj.name else [])
    assert len(keys) == len(set(keys))
    assert [pair[1] for pair in obj.suggestions] == sorted((pair[1] for pair in obj.suggestions), reverse=True) or (
        obj is before
    )
    assert not (before.name and not obj.name)
    assert set(added.named) | set(added.suggested) <= {1}
    if not added.named and not added.suggested:
        assert obj == before


def test_objects_that_are_gone_are_left_out() -> None:
    added = add_names(Objects((), no_evidence(0)), {7: {"mug": 0.9}}, name_probability=0.4)
    assert added.objects.table == () and added.named == added.suggested == ()


@given(st.integers(0, 60), st.integers(0, 40), st.integers(8, 20), st.integers(8, 20), st.floats(1, 4))
def test_a_closer_camera_sees_the_same_points_larger(x: int, y: int, width: int, height: int, scale: float) -> None:
    posed = PosedCamera(Camera(96, 72, 80.0, 80.0, 48.0, 36.0), np.eye(4), "a.png")
    box = np.array([x, y, x + width, y + height], np.float32)
    closer = closer_look(posed, box, scale, 640)
    assert closer is not None
    camera, inside = closer[0].camera, closer[1]
    factor = camera.fx / posed.camera.fx
    assert 0.9 <= factor <= scale * 1.1 and closer[0].name == "a.png"
    for column, row, corner in ((x, y, inside[:2]), (x + width, y + height, inside[2:])):
        ray = np.array([(column - 48.0) / 80.0, (row - 36.0) / 80.0])
        seen = ray * [camera.fx, camera.fy] + [camera.cx, camera.cy]
        assert seen == pytest.approx(corner, abs=1e-2)
    limits = np.array([camera.width, camera.height] * 2)
    assert (inside >= -1e-3).all() and (inside <= limits + 1e-3).all()


def test_what_fills_the_view_is_not_looked_at_closer() -> None:
    posed = PosedCamera(Camera(96, 72, 80.0, 80.0, 48.0, 36.0), np.eye(4))
    assert closer_look(posed, np.array([5, 5, 90, 70], np.float32), 4.0, 640) is None


def test_views_of_an_object_are_those_that_show_most_of_it() -> None:
    maps = np.zeros((3, 40, 40), np.int32)
    maps[0, :10, :10], maps[1, :20, :20], maps[2, :15, :15] = 4, 4, 4
    maps[1, 30:, 30:], maps[2, 39, 39] = 9, 9
    objects_seen = [objects_in_map(object_map) for object_map in maps]
    assert [[obj.object_id for obj in view] for view in objects_seen] == [[4], [4, 9], [4]]  # a speck is nothing
    assert best_positions(objects_seen, 2) == {4: (1, 2), 9: (1,)}
    assert objects_seen[0][0].box == pytest.approx([0, 0, 10, 10], abs=0.5) and objects_seen[0][0].pixels == 100


def test_boxes_vote_for_the_object_that_they_fit() -> None:
    boxes = np.array([[0, 0, 10, 10], [0, 0, 9, 10], [30, 30, 40, 40]], np.float32)
    detections = Detections(boxes, np.array([0.5, 0.7, 0.9], np.float32), ("mug", "mug", "cup"))
    votes = votes_for(detections, np.array([0, 0, 10, 10], np.float32), 0.5)
    assert votes == {"mug": pytest.approx(0.7)}
    assert mean_votes([votes, {}, {"cup": 0.3}]) == {"cup": pytest.approx(0.1), "mug": pytest.approx(0.7 / 3)}


_MEASURED = default_name_model()
_SCORES = st.lists(st.floats(0, 1), min_size=1, max_size=5)
_NAMES = st.sampled_from(["cup", "banana", "book", "what no detector says"])


def test_the_file_says_what_it_was_measured_on() -> None:
    model = default_name_model()
    assert model.sets and model.detector and model.factor > 0 and NAMED_FROM < STATED_FROM
    for category in model.categories.values():
        assert 0 <= category.right <= category.objects
    # Of two names that were seen as often the one that was right more often needs less evidence.
    seen = sorted(model.categories.values(), key=lambda category: category.objects)
    best = max(seen[-4:], key=lambda category: category.right / category.objects)
    worst = min(seen[-4:], key=lambda category: category.right / category.objects)
    assert best.offset > worst.offset


@settings(max_examples=60)
@given(_SCORES, _NAMES)
def test_probabilities_are_such_and_nothing_is_likely_that_no_view_says(scores: list[float], name: str) -> None:
    row = np.array([[0.0, *scores]])
    probability = name_probability(row, [name] * len(scores), _MEASURED)
    assert ((probability >= 0) & (probability <= 1)).all() and (probability[row == 0] == 0).all()


@settings(max_examples=60)
@given(st.floats(0, 1), st.floats(0, 1), _NAMES)
def test_a_second_name_makes_the_first_less_likely_and_a_higher_score_more(
    score: float, rival_score: float, name: str
) -> None:
    alone = name_probability(np.array([[0.0, score]]), [name], _MEASURED)[0, 1]
    beside = name_probability(np.array([[0.0, score, rival_score]]), [name, "another"], _MEASURED)[0, 1]
    assert beside <= alone + 1e-12
    assert name_probability(np.array([[0.0, score / 2]]), [name], _MEASURED)[0, 1] <= alone + 1e-12


def test_a_name_that_was_right_elsewhere_is_no_more_than_a_guess_without_evidence_of_its_own() -> None:
    likely = NameCategory(offset=9.0, objects=90, right=90)
    model = NameModel(detector="any", sets=("desk",), factor=1.0, offset=0.0, categories={"book": likely})
    little, much = model.probability(np.array([[0.59], [0.61]]), ["book"])[:, 0]
    assert NAMED_FROM <= little < STATED_FROM <= much
    doubtful = model.probability(np.array([[0.1], [0.59]]), ["cup"])[:, 0]
    np.testing.assert_allclose(doubtful, [0.1, 0.59])


def test_the_evidence_of_one_name_alone_is_its_mean_score() -> None:
    scores = np.array([[0.0, 0.6, 0.0], [0, 0, 0], [0, 0.4, 0.4]])
    np.testing.assert_allclose(name_evidence(scores), [[0, 0.6, 0], [0, 0, 0], [0, 0.2, 0.2]])
    first, nothing, twice = name_probability(scores, ["banana", "banana"], _MEASURED)
    assert first[1] > twice[1] == pytest.approx(twice[2]) and not nothing.any()


def test_what_was_measured_of_one_detector_says_nothing_of_another(tmp_path: Path) -> None:
    """Nor of its other bytes; a detector that is no better than chance suggests, too."""
    scores, folder = np.array([[0.0, 1.0, 0.0], [0.0, 0.2, 0.0]]), tmp_path / "mine"
    folder.mkdir()
    (folder / "network.onnx").write_bytes(b"first")
    counts = HeldOutNames(objects=90, called=60, right=40, chance=3, given=30, given_right=25, expected=24)
    measured = NameModel(detector="owlv2:mine", sets=("desk",), factor=1.0, offset=2.0, categories={}, held_out=counts)
    assert not any(load_name_model(name, tmp_path) for name in ("owlv2:mine", "picodet:mine", ""))
    save_name_model(measured, tmp_path)
    stored = load_name_model("owlv2:mine", tmp_path)
    assert stored is not None and stored.model_copy(update={"sha256": {}}) == measured
    assert load_name_model("owlv2:mine2", tmp_path) is None
    assert load_name_model(_MEASURED.detector, tmp_path) is _MEASURED
    assert name_probability(scores, ["banana", "cup"], measured)[0, 1] >= NAMED_FROM
    guessing = measured.model_copy(update={"held_out": counts.model_copy(update={"right": 8})})
    for model in (None, guessing):
        np.testing.assert_allclose(name_probability(scores, ["banana", "cup"], model), [[0, 0.5, 0], [0, 0.2, 0]])
    (folder / "network.onnx").write_bytes(b"other")
    assert load_name_model("owlv2:mine", tmp_path) is None
    (folder / "calibration.json").write_text("{}")
    with pytest.raises(ModelUnavailableError, match="damaged"):
        load_name_model("owlv2:mine", tmp_path)
