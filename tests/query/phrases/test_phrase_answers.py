"""Answers about places, sizes and colors, in a room whose layout is known; what cannot be decided is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fastsplat.service.query.edits.apply_edit import apply_edit
from fastsplat.service.query.language.words.query_text import check_query
from fastsplat.service.query.ranked_scene import RankedQuery
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.artefact.scene import Object, Parts, Scene
from fastsplat.service.scene.objects.label_evidence import UNIT, evidence_of
from fastsplat_contract.errors import LimitExceededError
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from fastsplat_contract.geometry.poses import look_at
from fastsplat_contract.messages.queries import Answer
from fastsplat_contract.messages.scenes import Edit
from tests.query.box_scenes import rigid
from tests.query.conftest import index_of
from tests.query.decisions import alike
from tests.query.placed_rooms import Room, box, crate, scene_of, table

_WORLD = rigid(3)
_ASKER = _WORLD @ look_at((0.0, -3.0, 1.5), (0.0, 0.0, 0.5))
_WOOD, _RED, _BLUE, _GREEN, _WHITE = (
    (0.72, 0.55, 0.38),
    (0.75, 0.1, 0.1),
    (0.12, 0.25, 0.75),
    (0.15, 0.55, 0.2),
    (0.95, 0.95, 0.93),
)
_TABLE, _CRATE, _RED_MUG, _BLUE_MUG, _BOOK, _BOTTLE, _BALL, _LAMP = range(1, 9)


def _room() -> Room:
    room = Room()
    room.place("table", table((1.4, 0.8, 0.75)), (0, 0, 0), 0.3, _WOOD)
    room.place("crate", crate((0.5, 0.4, 0.3)), (1.5, 0, 0), 0.1, _WOOD)
    room.place("mug", box((0.09, 0.09, 0.1)), (0.2, 0.1, 0.75), 0.2, _RED)
    room.place("mug", box((0.09, 0.09, 0.1)), (1.5, 0, 0.02), 0.2, _BLUE)
    room.place("book", box((0.2, 0.15, 0.06)), (-0.35, 0, 0.75), 0.2, _GREEN)
    room.place("bottle", box((0.08, 0.08, 0.25)), (-0.35, 0, 0.81), 0.2, _GREEN)
    room.place("ball", box((0.2, 0.2, 0.2)), (0, 0, 0), 0.2, _BLUE)
    room.place("lamp", box((0.15, 0.15, 0.4)), (0.5, 0.1, 0.75), 0.2, _WHITE)
    return room


@pytest.fixture(scope="module")
def scene() -> Scene:
    return scene_of(_room(), 0, _WORLD)


@pytest.fixture(scope="module")
def index(scene: Scene) -> SceneIndex:
    return index_of(scene)


def _answer(index: SceneIndex, text: str, asker: np.ndarray | None = _ASKER) -> Answer:
    query = RankedQuery(index.ranked, check_query((text,), index.settings))
    query.answer(lambda: index.objects, None if asker is _ASKER else _ASKER)  # from elsewhere first
    (answer,) = query.answer(lambda: index.objects, asker)
    return answer


def _reason(answer: Answer) -> str | None:
    assert answer.phrase is not None
    return None if answer.phrase.refusal is None else answer.phrase.refusal.reason


def test_a_phrasing_is_answered_as_its_bare_noun(index: SceneIndex) -> None:
    assert all(answer == bare for answer, bare in alike(index.ask))


@pytest.mark.parametrize(
    ("text", "objects"),
    [
        ("the mug on the table", {_RED_MUG}),
        ("the mug in the crate", {_BLUE_MUG}),
        ("what is under the table?", {_BALL}),
        ("the table above the ball", {_TABLE}),
        ("mugs that are not in the crate", {_RED_MUG}),
        ("the red mug", {_RED_MUG}),
        ("the blue mug", {_BLUE_MUG}),
        ("something white", {_LAMP}),
        ("the mug next to the lamp", {_RED_MUG}),
        ("the mug left of the lamp", {_RED_MUG}),
        ("the lamp right of the book", {_LAMP}),
        ("the mug between the book and the lamp", {_RED_MUG}),
        ("the mug nearest to the book", {_RED_MUG}),
        ("the farthest mug from the book", {_BLUE_MUG}),
        ("the mug closest to me", {_RED_MUG}),
        ("the largest object", {_TABLE}),
        ("the mug on the left", {_RED_MUG}),
        ("the second mug from the left", {_BLUE_MUG}),
        ("the red mug on the table next to the lamp", {_RED_MUG}),
    ],
)
def test_a_phrase_means_the_objects_that_were_placed_so(index: SceneIndex, text: str, objects: set[int]) -> None:
    answer = _answer(index, text)
    assert answer.phrase is not None and _reason(answer) is None and answer.outcome == "here"
    assert set(answer.phrase.object_ids) == set(answer.object_ids) == objects
    names = {obj.id: obj.name for obj in index.objects.listed}
    assert answer.outcome == "here" and answer.sentence.startswith("Here: ")
    assert all(f'"{names[obj]}"' in answer.sentence for obj in objects)
    decisive = [witness for witness in answer.phrase.witnesses if witness.object_id in objects]
    assert decisive and all(witness.clearness >= 1 for witness in decisive)


@pytest.mark.parametrize(("far", "nearest"), [(0.52, True), (0.49, False)])
def test_what_is_nearest_by_surfaces_is_so_where_the_middles_do_not_say_otherwise(far: float, nearest: bool) -> None:
    room = Room()
    room.place("ball", box((0.1, 0.1, 0.1)), (0, 0, 0), 0.0, _BLUE)
    large = room.place("crate", box((0.5, 0.5, 0.3)), (0.5, 0, 0), 0.0, _WOOD)
    room.place("crate", box((0.1, 0.1, 0.1)), (-far, 0, 0), 0.0, _WOOD)
    answer = _answer(index_of(scene_of(room, 0, _WORLD)), "the crate nearest to the ball")
    assert (answer.object_ids == (large,) and answer.outcome == "here") == nearest
    assert _reason(answer) == (None if nearest else "too_close")


def test_numbers_are_counted(index: SceneIndex) -> None:
    for text, count in (("how many mugs are there?", 2), ("how many mugs are on the table?", 1)):
        answer = _answer(index, text)
        assert answer.phrase is not None and answer.phrase.count == count == len(answer.object_ids)
        assert answer.sentence.startswith(f"Here: {count} (")


@pytest.mark.parametrize("text", ["the green mug", "the mug under the table", "how many mugs are behind the lamp?"])
def test_what_nothing_fulfils_is_absent_and_nobody_says_how_probable_that_is(index: SceneIndex, text: str) -> None:
    answer = _answer(index, text)
    assert answer.phrase is not None and _reason(answer) is None
    assert answer.is_absent and answer.object_ids == () == answer.relevant_ids
    assert answer.probability is None and answer.presence is None
    assert answer.sentence.startswith("Not here: nothing is ")
    assert answer.phrase.count == (0 if text.startswith("how") else None)
    assert not index.mask3d(answer).any() and index.objects_of(answer) == ()


@pytest.mark.parametrize(
    ("text", "asker", "reason"),
    [
        ("the mug left of the lamp", None, "pose_needed"),
        ("the nearest mug", None, "pose_needed"),
        ("the second mug from the left", None, "pose_needed"),
        ("the mug left of the lamp", _WORLD @ look_at((0.0, 3.0, 1.5), (0.0, 6.0, 1.0)), "out_of_view"),
        ("the bottle on the table", None, "indirect"),
        ("how many objects are on the table?", None, "indirect"),
        ("the lamp next to the mug", None, "ambiguous_referent"),
        ("the lamp nearest to the mug", None, "ambiguous_referent"),
        ("the mug on the piano", None, "referent_absent"),
        ("the green mug on the red table", None, "referent_absent"),
        ("the big lamp", None, "nothing_to_compare"),
        ("the mug on the table that broke", None, "not_understood"),
        ("the mug full of water", None, "not_measured"),
        ("the mug without a handle", None, "not_measured"),
        ("the silver lamp", None, "not_measured"),
        ("the largest mug", None, "too_close"),
    ],
)
def test_what_cannot_be_decided_has_a_verdict_of_its_own(
    index: SceneIndex, text: str, asker: np.ndarray | None, reason: str
) -> None:
    answer = _answer(index, text, asker)
    assert answer.phrase is not None and _reason(answer) == reason
    assert (answer.outcome, answer.relation, answer.probability) == ("cannot_say", "undecided", None)
    assert answer.outcome == "cannot_say" and answer.sentence.startswith("Cannot say: ")
    assert answer.phrase.count is None and index.ranked.names.picks(answer) == answer.object_ids
    names = {obj.id: obj.name for obj in index.objects.listed}
    labels = {match.label for match in answer.matches if match.relevant}
    assert labels == {names[obj] for obj in answer.object_ids} and set(answer.phrase.undecided) <= set(
        answer.object_ids
    )


@pytest.mark.parametrize("text", ["the piano on the table", "how many pianos are there?"])
def test_what_is_not_here_is_not_on_anything(index: SceneIndex, text: str) -> None:
    answer = _answer(index, text)
    assert answer.phrase is not None and (answer.is_absent, _reason(answer), answer.object_ids) == (True, None, ())
    assert answer.phrase.count == (0 if text.startswith("how") else None)


@pytest.mark.parametrize("text", ["the mug on the table", "what is under the table?", "the tallest mug"])
def test_without_a_vertical_nothing_is_on_anything(text: str) -> None:
    assert _reason(_answer(index_of(scene_of(_room(), 0, _WORLD, cameras=False)), text)) == "vertical_unknown"


@pytest.mark.parametrize(
    "text",
    ["mug", "the mugs", "something to drink from", "where is the lamp?", "Tasse", "old mug", "object that keeps time"],
)
def test_a_plain_question_is_answered_as_if_nothing_were_parsed(index: SceneIndex, text: str) -> None:
    answer = _answer(index, text)
    (plain,) = index.ranked.ranker.rank(check_query((text,), index.settings))
    said = {name: getattr(answer, name) for name in ("outcome", "sentence", "noun_phrase")}
    assert answer == replace(plain.answer, **said) and answer.phrase is None


def test_a_witness_says_which_objects_what_and_how_clear(index: SceneIndex) -> None:
    for scene_index, unit in ((index, "m"), (index_of(replace(index.scene, scale="ARBITRARY")), "unit")):
        phrase = _answer(scene_index, "the mug on the table").phrase
        assert phrase is not None and phrase.conditions == ("on the table",) and phrase.head == "mug"
        red = {witness.measure: witness for witness in phrase.witnesses if witness.object_id == _RED_MUG}
        assert red["gap"].compared_ids == (_TABLE,) and red["gap"].unit == unit and abs(red["gap"].value) < 0.01
        assert red["overlap"].value > 0.9 and min(red["gap"].clearness, red["overlap"].clearness) >= 1
        blue = [witness for witness in phrase.witnesses if witness.object_id == _BLUE_MUG]
        assert min(witness.clearness for witness in blue) <= -1


def test_a_color_picks_what_comes_closest_where_nothing_is_clearly_of_it() -> None:
    room = Room()
    for at, color in enumerate((_WHITE, (0.9, 0.35, 0.15), (0.62, 0.36, 0.28))):
        room.place("book", box((0.2, 0.15, 0.06)), (at, 0, 0), 0.2, color)
    index = index_of(scene_of(room, 0, _WORLD))
    for text in ("the red book", "what is red?"):
        answer = _answer(index, text)
        assert (answer.outcome, answer.object_ids[:1]) == ("probably_here", (3,)) and 1 not in answer.object_ids
        assert index.mask3d(answer).sum() == answer.matches[0].gaussian_count


def test_masks_and_objects_are_of_the_meant_objects_alone(index: SceneIndex) -> None:
    answer = _answer(index, "the red mug")
    assert (index.mask3d(answer) == (index.objects.owner == _RED_MUG)).all()
    assert [obj.id for obj in index.objects_of(answer)] == [_RED_MUG]
    pose = _WORLD @ look_at((0.2, -0.5, 1.0), (0.2, 0.1, 0.8))
    view = PosedCamera(Camera(96, 72, 90.0, 90.0, 48.0, 36.0), pose)
    inside = index.objects.map(view) == _RED_MUG
    assert inside.any() and (index.mask(answer, view) == inside).all()
    assert (index.mask2d(answer, view).mask == inside).all()


@pytest.mark.parametrize("factor", [0.01, 100.0])
def test_the_scale_of_a_scene_changes_no_answer(scene: Scene, index: SceneIndex, factor: float) -> None:
    gaussians = replace(
        scene.gaussians,
        means=scene.gaussians.means * np.float32(factor),
        log_scales=scene.gaussians.log_scales + np.float32(np.log(factor)),
    )
    poses = [camera.world_from_camera.copy() for camera in scene.cameras]
    asker = _ASKER.copy()
    for pose in (*poses, asker):
        pose[:3, 3] *= factor
    cameras = tuple(replace(camera, world_from_camera=pose) for camera, pose in zip(scene.cameras, poses, strict=True))
    scaled = index_of(replace(scene, gaussians=gaussians, cameras=cameras))
    for text in ("what is on the table?", "mug next to the lamp", "the mug left of the lamp", "the nearest mug"):
        assert _answer(scaled, text, asker).object_ids == _answer(index, text).object_ids


def test_a_part_that_is_known_decides_what_an_object_has(scene: Scene) -> None:
    assert scene.objects is not None
    owner = index_of(scene).objects.owner
    rows = [np.flatnonzero(owner == mug)[:40] for mug in (_RED_MUG, _BLUE_MUG)]
    nameless = (Object(20, parent=_RED_MUG), Object(21, parent=_BLUE_MUG))
    ids = np.repeat([20, 21], [len(part_rows) for part_rows in rows])
    parts = Parts(nameless, evidence_of(np.concatenate(rows), ids, np.full(len(ids), 16 * UNIT), len(owner)))
    parted = index_of(replace(scene, objects=replace(scene.objects, parts=parts)))
    for part, name in ((20, "handle"), (21, "lid")):
        parted = parted.after(apply_edit(parted, Edit("name", object_ids=(part,), name=name)))
    assert _answer(parted, "the mug with a handle").object_ids == (_RED_MUG,)
    assert _answer(parted, "the mug without a handle").object_ids == (_BLUE_MUG,)
    assert _answer(parted, "the handle of the mug").object_ids == (20,)


def test_a_question_about_all_pairs_of_many_objects_is_refused() -> None:
    room = Room()
    for number in range(70):
        room.place("mug", box((0.09, 0.09, 0.1)), (0.3 * (number % 10), 0.3 * (number // 10), 0), 0.0, _RED)
    crowded = index_of(scene_of(room, 0, _WORLD))
    with pytest.raises(LimitExceededError) as caught:
        _answer(crowded, "the object nearest to something")
    assert caught.value.field == "texts"
    assert _reason(_answer(crowded, "the nearest mug", None)) == "pose_needed"


def test_a_text_of_two_readings_is_answered_if_one_of_them_makes_sense() -> None:
    room = Room()
    room.place("table", table((1.4, 0.8, 0.75)), (0, 0, 0), 0.0, _WOOD)
    beside_lamp = room.place("mug", box((0.09, 0.09, 0.1)), (-0.5, 0, 0.75), 0.0, _RED)
    room.place("street lamp", box((0.3, 0.3, 1.2)), (1.05, 0, 0), 0.0, _WOOD)
    room.place("table", table((1.4, 0.8, 0.75)), (0, 4, 0), 0.0, _WOOD)
    with_lamp = room.place("mug", box((0.09, 0.09, 0.1)), (0, 4, 0.75), 0.0, _RED)
    room.place("desk lamp", box((0.15, 0.15, 0.4)), (0.2, 4, 0.75), 0.0, _WHITE)
    index = index_of(scene_of(room, 0, _WORLD))
    assert _answer(index, "the mug on a table next to the street lamp").object_ids == (beside_lamp,)
    assert _answer(index, "the mug on a table next to the desk lamp").object_ids == (with_lamp,)
    both = "the mug on a table next to something"
    assert _reason(_answer(index, both)) == "ambiguous"
