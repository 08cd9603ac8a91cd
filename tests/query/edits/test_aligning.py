"""Scenes put into the frame of a map: against known motions, there and back, seen alike, refused where senseless."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fastsplat.service.common.similarity import Similarity
from fastsplat.service.query.drawing.scene_renderer import Renderer
from fastsplat.service.query.edits.aligning import align_scene, fit_pairs
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.artefact.frames import frame_of, scaled
from fastsplat.service.scene.artefact.scaling import combined
from fastsplat.service.scene.artefact.scene import Scene
from fastsplat.service.scene.artefact.scene_files import read_scene, write_scene
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from fastsplat_contract.geometry.places import Alignment, PointPair
from fastsplat_contract.geometry.poses import Pose, Vector3, quaternion_of, vector3
from fastsplat_contract.messages.scenes import Edit
from tests.query.conftest import DrawnEncoder
from tests.scenes import labelled_scene

_RANDOM = np.random.default_rng(7)
_TRUE = Similarity(0.31, Rotation.from_euler("xyz", [0.3, -1.1, 2.0]).as_matrix(), np.array([4.0, -2.0, 1.5]))


def _scene(scale: str = "ARBITRARY") -> Scene:
    means = _RANDOM.normal(0, 0.4, size=(60, 3))
    sh = _RANDOM.normal(0, 0.3, size=(60, 16, 3)).astype(np.float32)
    pose = np.eye(4)
    pose[:3, 3] = [0.1, -0.2, -3.0]
    camera = PosedCamera(Camera(48, 36, 50.0, 50.0, 24.0, 18.0), pose, "front.png")
    return labelled_scene(
        means, 1 + np.arange(60) % 2, ["mug", "box"], scales=0.08, sh=sh, cameras=[camera], scale=scale
    )


def _aligned(scene: Scene, alignment: Alignment) -> Scene:
    return align_scene(SceneIndex(scene, DrawnEncoder(), QuerySettings()), Edit("align", alignment=alignment))


def _pairs(points: np.ndarray, world: np.ndarray) -> tuple[PointPair, ...]:
    return tuple(PointPair(vector3(point), vector3(target)) for point, target in zip(points, world, strict=True))


@pytest.mark.parametrize("count", [3, 4, 9])
def test_the_similarity_of_exact_pairs_is_the_true_one(count: int) -> None:
    points = _RANDOM.normal(size=(count, 3))
    fit = fit_pairs(points, _TRUE.points(points), scaled=True)
    assert fit.change.scale == pytest.approx(_TRUE.scale) and not fit.outliers.any()
    assert np.allclose(fit.change.rotation, _TRUE.rotation) and np.allclose(fit.change.translation, _TRUE.translation)
    assert fit.rms == pytest.approx(0, abs=1e-12)


def test_the_interval_of_the_scale_holds_as_often_as_it_says() -> None:
    held = 0
    for seed in range(200):
        random = np.random.default_rng(seed)
        points = random.normal(size=(4, 3))
        fit = fit_pairs(points, _TRUE.points(points) + random.normal(0, 0.01, size=(4, 3)), scaled=True)
        held += abs(np.log(fit.change.scale / _TRUE.scale)) <= 1.96 * fit.deviation
    assert 180 <= held <= 200  # 190 expected, of 200


def test_outliers_are_left_out_and_reported() -> None:
    points = _RANDOM.normal(size=(8, 3))
    world = _TRUE.points(points) + _RANDOM.normal(0, 0.002, size=(8, 3))
    world[[2, 5]] += [0.7, -0.4, 0.5]
    fit = _aligned(_scene(), Alignment("map", pairs=_pairs(points, world))).alignment
    assert fit is not None and fit.outliers == (2, 5)
    assert fit.rms is not None and fit.rms < 0.01 and min(fit.residuals[2], fit.residuals[5]) > 0.5


@pytest.mark.parametrize(
    ("points", "world", "message"),
    [
        (np.eye(3)[:2], np.eye(3)[:2], "2 pairs"),
        (np.outer(np.arange(4), [1.0, 2.0, 3.0]), _TRUE.points(np.outer(np.arange(4), [1.0, 2.0, 3.0])), "one line"),
        (np.zeros((4, 3)), np.zeros((4, 3)), "one line"),
        (np.vstack([np.eye(3), [[1, 1, 1.5]]]), np.vstack([np.eye(3), [[1, 1, 1.5]]]) * [1, 1, -1], "mirror"),
        (np.full((3, 3), np.nan), np.eye(3), "not finite"),
        (np.random.default_rng(1).normal(size=(9, 3)), np.random.default_rng(2).normal(size=(9, 3)), "half of|mirror"),
    ],
    ids=["two", "line", "point", "mirrored", "nan", "nonsense"],
)
def test_pairs_that_tell_nothing_are_refused(points: np.ndarray, world: np.ndarray, message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        fit_pairs(points.astype(float), world.astype(float), scaled=True)


def test_a_camera_that_goes_along_sees_the_same() -> None:
    scene = _scene()
    points = _RANDOM.normal(size=(4, 3))
    aligned = _aligned(scene, Alignment("map", pairs=_pairs(points, _TRUE.points(points))))
    before = Renderer(scene, QuerySettings()).colors(scene.cameras[0])
    after = Renderer(aligned, QuerySettings()).colors(aligned.cameras[0])
    assert before.std() > 10 and np.abs(before.astype(int) - after).max() <= 1
    assert aligned.scale == "METRIC" and aligned.scaling is not None
    assert aligned.scaling.meters_per_unit == pytest.approx(_TRUE.scale)
    assert np.allclose(frame_of(aligned).points(scene.gaussians.means), aligned.gaussians.means, atol=1e-5)
    assert np.allclose(frame_of(aligned).inverse().points(aligned.gaussians.means), scene.gaussians.means, atol=1e-5)


def test_a_metric_scene_keeps_its_lengths() -> None:
    scene = _scene("METRIC")
    points = _RANDOM.normal(size=(5, 3))
    rigid = Similarity(1.0, _TRUE.rotation, _TRUE.translation)
    aligned = _aligned(scene, Alignment("map", pairs=_pairs(points, rigid.points(points) * 1.0)))
    assert aligned.scaling is None and aligned.scale == "METRIC"
    assert np.allclose(aligned.gaussians.log_scales, scene.gaussians.log_scales)
    motion = Pose(vector3(_TRUE.translation), quaternion_of(_TRUE.rotation))
    by_motion = _aligned(_scene("METRIC"), Alignment("map", motion))
    assert by_motion.alignment is not None and by_motion.alignment.rms is None and by_motion.alignment.pairs == 0


def test_alignments_and_scales_follow_each_other(tmp_path: Path) -> None:
    scene = _scene()
    points = _RANDOM.normal(size=(4, 3))
    aligned = _aligned(scene, Alignment("map", pairs=_pairs(points, _TRUE.points(points))))
    assert aligned.scaling is not None
    again = _aligned(aligned, Alignment("room", Pose(Vector3(1.0, 0.0, 0.0), quaternion_of(np.eye(3)))))
    assert np.allclose(frame_of(again).points(scene.gaussians.means), again.gaussians.means, atol=1e-5)
    assert again.scaling is not None
    longer = combined([*again.scaling.lengths, *again.scaling.lengths])
    result = scaled(again, longer)
    assert np.allclose(frame_of(result).points(scene.gaussians.means), result.gaussians.means, atol=1e-5)
    write_scene(result, tmp_path / "scene")
    assert read_scene(tmp_path / "scene").alignment == result.alignment


@pytest.mark.parametrize(
    "alignment", [Alignment("map"), Alignment("two\nlines", Pose(Vector3(0, 0, 0), quaternion_of(np.eye(3))))]
)
def test_orders_that_make_no_sense_are_refused(alignment: Alignment) -> None:
    with pytest.raises(InvalidInputError):
        _aligned(_scene(), alignment)
