"""Objects as robots need them: poses as sure as they are said to be, in every frame and unit; what carries them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

import numpy as np
import pytest

from fastsplat.service.query.edits.apply_edit import apply_edit
from fastsplat.service.query.measures.object_detections import detections_of
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.artefact.scene import Object, Objects, Scene, SceneFacts
from fastsplat.service.scene.artefact.suggestions import Suggestion
from fastsplat.service.scene.objects.label_evidence import evidence_of
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.geometry.places import Alignment, KnownLength, Place, PointPair
from fastsplat_contract.geometry.poses import Pose, Vector3, pose_of, quaternion_of, vector3
from fastsplat_contract.messages.detections import Detection, DetectionList
from fastsplat_contract.messages.scenes import Edit
from tests.query.box_scenes import BoxShell, orbit, rigid, scene_of
from tests.query.conftest import index_of
from tests.query.room import turned

_TABLE = BoxShell("table", (0.0, 0.0, 0.35), (1.2, 0.7, 0.7), count=6_000)
_BOOK = BoxShell("book", (0.2, 0.1, 0.725), (0.3, 0.15, 0.05), yaw=0.5, count=3_000)
_DIE = BoxShell("die", (-0.3, -0.1, 0.75), (0.1, 0.1, 0.1), count=2_000)
_ALL = (_TABLE, _BOOK, _DIE)


def _scene(shells: Sequence[BoxShell] = _ALL, cameras: Sequence[PosedCamera] | None = None, **changes: Any) -> Scene:
    scene = scene_of(shells, orbit(8, 2.0, 1.6) if cameras is None else cameras)
    rows = np.repeat(np.arange(len(shells)) + 1, [shell.count for shell in shells])
    table = tuple(
        Object(n, shell.label, "detected", 0.9, 0.75, suggestions=(Suggestion("other", 0.1),))
        for n, shell in enumerate(shells, 1)
    )
    members = evidence_of(np.arange(len(rows)), rows, np.full(len(rows), 4096 * 50), len(rows))
    return replace(scene, objects=Objects(table, members), **changes)


def _listed(index: SceneIndex) -> DetectionList:
    return detections_of(index, index.objects.listed, "7")


def _of(index: SceneIndex, label: str) -> Detection:
    return next(obj for obj in _listed(index).detections if obj.label == label)


def _position(detection: Detection) -> np.ndarray:
    return detection.covariance()[:3, :3]


def _symmetric_and_positive(matrix: np.ndarray) -> bool:
    return bool(np.allclose(matrix, matrix.T) and np.linalg.eigvalsh(matrix).min() >= -1e-15)


def test_objects_are_where_they_are_with_their_names_and_what_carries_them() -> None:
    answer = _listed(index_of(_scene()))
    assert (answer.version, answer.frame_id, answer.meters, answer.next_page_token) == ("7", "world", True, "")
    assert answer.up is not None and answer.up == pytest.approx((0, 0, 1), abs=0.01)
    assert [obj.label for obj in answer.detections] == ["table", "book", "die"]
    table, book, die = answer.detections
    assert [obj.support and (obj.support.label, obj.support.relation) for obj in (table, book, die)] == [
        None,
        ("table", "on"),
        ("table", "on"),
    ]
    assert book.support is not None and book.support.clearness >= 1 and book.support.object_id == table.object_id
    for obj, shell in zip(answer.detections, _ALL, strict=True):
        assert obj.box is not None
        error = np.array(obj.box.center.position) - shell.centre
        assert error @ np.linalg.solve(_position(obj), error) < 16.0, (shell.label, error)  # 4 deviations
        assert (obj.probability, obj.consensus, [name for name, *_ in obj.alternatives]) == (0.9, 0.75, ["other"])
        assert obj.covariance_terms == ("edges", "membership") and _symmetric_and_positive(_position(obj))


def test_a_heading_is_as_sure_as_the_shape_tells_it() -> None:
    index = index_of(_scene())
    book, die = _of(index, "book"), _of(index, "die")
    assert book.box is not None
    x, y, _ = book.box.center.matrix()[:3, 0]
    turn = (np.arctan2(y, x) - _BOOK.yaw + np.pi / 2) % np.pi - np.pi / 2  # which end is the front is not known
    heading = np.sqrt(book.covariance()[5, 5])
    assert abs(turn) < 3 * heading < np.radians(45)
    assert _symmetric_and_positive(book.covariance())
    if die.rotation_covariance:  # of a cube it is less sure, if it can be said
        assert die.covariance()[5, 5] > book.covariance()[5, 5]


def test_a_round_object_has_no_heading() -> None:
    scene = _scene()
    angles = np.random.default_rng(1).uniform(0, 2 * np.pi, _DIE.count)
    means = scene.gaussians.means.copy()
    means[-_DIE.count :, 0] = _DIE.centre[0] + 0.05 * np.cos(angles)
    means[-_DIE.count :, 1] = _DIE.centre[1] + 0.05 * np.sin(angles)
    cup = _of(index_of(replace(scene, gaussians=replace(scene.gaussians, means=means))), "die")
    assert cup.box is not None and cup.position_covariance and cup.rotation_covariance == ()
    assert np.isnan(cup.covariance()[3:, 3:]).all() and not np.isnan(cup.covariance()[:3, :3]).any()


@pytest.mark.parametrize("seed", [1, 2])
def test_what_is_said_goes_along_with_the_frame(seed: int) -> None:
    index, motion = index_of(_scene()), rigid(seed)
    pose = pose_of(motion)
    moved = index_of(apply_edit(index, Edit("align", alignment=Alignment("hall", pose))))
    before, after = _listed(index), _listed(moved)
    assert after.frame_id == "hall" and after.up is not None and before.up is not None
    np.testing.assert_allclose(after.up, motion[:3, :3] @ before.up, atol=1e-6)
    for old, new in zip(before.detections, after.detections, strict=True):
        assert (old.label, old.views, old.consensus) == (new.label, new.views, new.consensus)
        assert old.box is not None and new.box is not None
        np.testing.assert_allclose(
            new.box.center.position, motion[:3, :3] @ old.box.center.position + motion[:3, 3], atol=5e-3
        )
        turned = motion[:3, :3] @ _position(old) @ motion[:3, :3].T
        np.testing.assert_allclose(_position(new), turned, atol=0.3 * np.abs(turned).max())
        assert (old.support and old.support.object_id) == (new.support and new.support.object_id)


def test_what_the_scale_leaves_unsure_grows_with_the_distance_from_where_lengths_are_scaled() -> None:
    known = KnownLength(Place(point=Vector3(0, 0, 0)), Place(point=Vector3(1, 0, 0)), 2.0, 0.08)
    plain = index_of(_scene(scale="ARBITRARY"))
    assert not _listed(plain).meters and "scale" not in _of(plain, "book").covariance_terms
    index = index_of(apply_edit(plain, Edit("scale", known_lengths=(known,))))
    book, before = _of(index, "book"), _of(plain, "book")
    assert book.box is not None and "scale" in book.covariance_terms and _listed(index).meters
    assert index.scene.scaling is not None
    arm = index.scene.scaling.deviation * np.array(book.box.center.position)
    np.testing.assert_allclose(_position(book), 4 * _position(before) + np.outer(arm, arm), rtol=0.1, atol=1e-7)
    # The frame of a map: lengths are still scaled from where the trained scene has its origin.
    shifted = Pose(Vector3(100.0, 0.0, 0.0), quaternion_of(np.eye(3)))
    far = index_of(apply_edit(index, Edit("align", alignment=Alignment("map", shifted))))
    np.testing.assert_allclose(_position(_of(far, "book")), _position(book), rtol=0.1, atol=1e-6)


def test_pairs_of_points_that_fit_badly_make_positions_unsure() -> None:
    noise = np.random.default_rng(3).normal(0, 0.02, (4, 3))
    corners = np.array([[0, 0, 0], [2, 0, 0], [0, 2, 0], [0, 0, 2.0]])
    pairs = tuple(PointPair(vector3(corner), vector3(corner + off)) for corner, off in zip(corners, noise, strict=True))
    plain = index_of(_scene())
    index = index_of(apply_edit(plain, Edit("align", alignment=Alignment("map", pairs=pairs))))
    rms = index.scene.alignment.rms if index.scene.alignment else None
    assert rms
    book, before = _of(index, "book"), _of(plain, "book")
    assert book.covariance_terms == (*before.covariance_terms, "alignment")
    assert np.trace(_position(book)) == pytest.approx(np.trace(_position(before)) + rms**2, rel=0.05)


def test_gaussians_that_may_belong_to_others_make_a_position_unsure() -> None:
    scene = _scene()
    assert scene.objects is not None
    rows = np.repeat([1, 2, 3], [shell.count for shell in _ALL])
    doubtful = (rows == 2) & (scene.gaussians.means[:, 0] > _BOOK.centre[0])
    entries = np.concatenate([np.arange(len(rows)), np.flatnonzero(doubtful)])
    labels = np.concatenate([rows, np.full(doubtful.sum(), 1)])
    counts = np.concatenate([np.full(len(rows), 4096 * 50), np.full(doubtful.sum(), 4096 * 49)])
    # Half of the book was often taken for the table: where its far end is, is less sure.
    counts[np.flatnonzero(doubtful & (np.arange(len(rows)) % 40 != 0))] = 4096 * 50
    members = evidence_of(entries, labels, counts, len(rows))
    index = index_of(replace(scene, objects=replace(scene.objects, membership=members)))
    sure, unsure = _of(index_of(scene), "book"), _of(index, "book")
    assert np.trace(_position(unsure)) > np.trace(_position(sure))


def test_nothing_is_said_of_up_where_nothing_tells_it() -> None:
    answer = _listed(index_of(_scene(cameras=(), scale="ARBITRARY")))
    assert answer.up is None and not answer.meters
    for obj in answer.detections:
        assert (obj.support, obj.rotation_covariance, obj.views) == (None, (), ())
        assert obj.box is not None and len(obj.position_covariance) == 9 and obj.first_seen is obj.last_seen is None


def test_times_are_those_of_the_photos_that_see_an_object() -> None:
    scene = _scene()
    names = [posed.name for posed in scene.cameras]
    times = {name: 1_700_000_000.0 + 60 * n for n, name in enumerate(names)}
    index = index_of(replace(scene, facts=SceneFacts(taken_at=times)))
    book = _of(index, "book")
    assert set(book.views) <= set(names) and book.views
    view_times = [times[name] for name in book.views]
    assert book.first_seen == datetime.fromtimestamp(min(view_times), UTC)
    assert book.last_seen == datetime.fromtimestamp(max(view_times), UTC)
    few = index_of(replace(scene, facts=SceneFacts(taken_at={"another.jpg": 1_700_000_000.0})))
    assert (_of(few, "book").first_seen, _of(few, "book").last_seen) == (None, None)


def test_who_proposed_an_object_and_who_missed_it_is_named() -> None:
    scene = _scene()
    assert scene.objects is not None
    table, book, die = scene.objects.table
    noted = replace(book, proposed_in=(0, 2), missed_in=(5,))
    index = index_of(replace(scene, objects=replace(scene.objects, table=(table, noted, die))))
    assert (_of(index, "book").proposed_in, _of(index, "book").missed_in) == (("0.jpg", "2.jpg"), ("5.jpg",))
    assert (_of(index, "die").proposed_in, _of(index, "die").missed_in) == ((), ())
    # No photo shows a copy.
    copy = apply_edit(index, Edit("duplicate", label="book", transform=pose_of(turned(0, z=1.0))))
    assert copy.objects is not None
    assert [obj.proposed_in for obj in copy.objects.table if obj.name == "book"] == [(0, 2), ()]


def test_a_scene_that_stores_no_objects_says_nothing_of_views_that_agree() -> None:
    index = index_of(replace(_scene(), objects=None))
    assert index.objects.stored is False
    for obj in _listed(index).detections:
        assert obj.consensus is None and "membership" not in obj.covariance_terms


def test_what_hangs_on_a_wall_is_carried_by_it_and_a_wall_by_nothing() -> None:
    wall = BoxShell("wall", (0.0, 1.0, 0.8), (2.0, 0.02, 1.6), count=6_000)
    picture = BoxShell("picture", (0.3, 0.97, 1.1), (0.4, 0.03, 0.3), count=2_000)
    scene = _scene((_TABLE, _BOOK, wall, picture))
    assert scene.objects is not None
    table = tuple(replace(obj, surface="wall") if obj.name == "wall" else obj for obj in scene.objects.table)
    index = index_of(replace(scene, objects=replace(scene.objects, table=table)))
    carried = {obj.label: obj.support and (obj.support.label, obj.support.relation) for obj in _listed(index)[0]}
    assert carried == {"table": None, "book": ("table", "on"), "wall": None, "picture": ("wall", "on")}
