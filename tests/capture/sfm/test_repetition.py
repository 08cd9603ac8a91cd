"""A wall whose pattern repeats misleads the usual mapping: pairs that contradict others go, or the user is told."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest
from numpy.typing import NDArray

from fastsplat.service.capture.build import build_capture
from fastsplat.service.capture.sfm.mapping import Mapping, mapper_options
from fastsplat.service.capture.uploads.upload_validation import validate_upload
from fastsplat.service.common.progress import silent
from fastsplat.service.common.similarity import fit_similarity
from fastsplat_contract.errors import ReconstructionError

_TILE = 256  # texture pixels; a world unit
_K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])


def _texture(rng: np.random.Generator) -> np.ndarray:
    coarse = rng.integers(0, 256, (40, 40, 3), dtype=np.uint8)
    return cv2.resize(coarse, (_TILE, _TILE), interpolation=cv2.INTER_CUBIC)


def _walk(folder: Path, *, repeat: bool) -> np.ndarray:
    """Twelve views along a wall of 12×4 tiles with a ledge before it; returns the true centers [12, 3]."""
    rng = np.random.default_rng(0)
    first = _texture(rng)
    wall = np.vstack([np.hstack([first if repeat else _texture(rng) for _ in range(12)]) for _ in range(4)])
    wall = np.clip(wall + 3 * rng.normal(size=wall.shape), 0, 255).astype(np.uint8)
    ledge = np.zeros(wall.shape[:2], np.uint8)
    ledge[int(2.3 * _TILE) :] = 255
    folder.mkdir()
    centers = []
    for index in range(12):
        angle = 0.1 * np.sin(1.3 * index)
        turn = np.array([[np.cos(angle), 0, -np.sin(angle)], [0, 1, 0], [np.sin(angle), 0, np.cos(angle)]])
        center = np.array([2.5 + 0.2 * index, 2 + 0.15 * np.sin(2.1 * index), -2.2 - 0.3 * np.cos(index)])
        canvas = np.zeros((480, 640, 3), np.uint8)
        for z, texture, extent in ((0.0, wall, np.full_like(ledge, 255)), (-0.6, wall[::-1].copy(), ledge)):
            columns = [turn[:, 0] / _TILE, turn[:, 1] / _TILE, turn @ (np.array([0, 0, z]) - center)]
            plane = _K @ np.column_stack(columns)
            mask = cv2.warpPerspective(extent, plane, (640, 480)) > 128
            canvas[mask] = cv2.warpPerspective(texture, plane, (640, 480), flags=cv2.INTER_AREA)[mask]
        cv2.imwrite(str(folder / f"{index:02d}.png"), canvas)
        centers.append(center)
    return np.array(centers)


@pytest.mark.parametrize("repeat", [False, True])
def test_a_repeating_wall_is_never_wrong_in_silence(repeat: bool, tmp_path: Path, settings) -> None:
    some = settings.model_copy(update={"sfm_features": 4096 if repeat else 1800})
    truth = _walk(tmp_path / "upload", repeat=repeat)
    validate_upload(tmp_path / "upload", some)
    try:
        capture = build_capture(tmp_path / "upload", tmp_path / "out", some, silent)
    except ReconstructionError:
        assert repeat
        return
    registered = truth[[int(view.posed.name[:2]) for view in capture.views]]
    centers = np.array([view.posed.world_from_camera[:3, 3] for view in capture.views])
    slip = np.linalg.norm(fit_similarity(centers, registered).points(centers) - registered, axis=1).max()
    assert capture.report.mean_reprojection_error_px < 1  # which says nothing, hence all this
    warned = any("repeat" in warning for warning in capture.report.warnings)
    assert (slip < 0.5 or warned) if repeat else (slip < 0.02 and not warned and len(registered) == 12)


_PERIOD = 3.0
_FOCAL, _WIDTH, _HEIGHT = 500.0, 640, 480
_CAMERAS = 10
_WRONG = (5, 6)  # photos so many steps apart agree on the wrong copy of the pattern


def _centers() -> NDArray[np.float64]:
    steps = np.arange(_CAMERAS)
    return np.stack([2 + 0.7 * steps, 2 + 0.3 * np.sin(2.1 * steps), -4 - 0.4 * np.cos(steps)], axis=1)


def _write_wall(database: Path) -> None:
    """Five copies of a tile of 120 points, and matches of the photos along it."""
    rng = np.random.default_rng(3)
    tile = rng.uniform([0, 0, 0], [_PERIOD, 4, 2.5], (120, 3))
    points = np.concatenate([tile + np.array([_PERIOD * (copy - 1), 0, 0]) for copy in range(5)])
    seen = []
    for center in _centers():
        rays = points - center
        pixels = _FOCAL * rays[:, :2] / rays[:, 2:] + [_WIDTH / 2, _HEIGHT / 2]
        rows = np.flatnonzero(((pixels >= 0) & (pixels < [_WIDTH, _HEIGHT])).all(axis=1))
        seen.append((rows, pixels[rows] + rng.normal(0, 0.1, (len(rows), 2))))
    with pycolmap.Database.open(database) as writer:
        camera = pycolmap.Camera(
            model="SIMPLE_RADIAL", width=_WIDTH, height=_HEIGHT, params=[_FOCAL, _WIDTH / 2, _HEIGHT / 2, 0.0]
        )
        camera.has_prior_focal_length = True
        camera.camera_id = writer.write_camera(camera)
        rig = pycolmap.Rig()
        rig.add_ref_sensor(camera.sensor_id)
        rig.rig_id = writer.write_rig(rig)
        for index, (_, pixels) in enumerate(seen):
            image = pycolmap.Image(name=f"{index:02d}.png", camera_id=camera.camera_id)
            image.image_id = writer.write_image(image)
            frame = pycolmap.Frame()
            frame.rig_id = rig.rig_id
            frame.add_data_id(image.data_id)
            writer.write_frame(frame)
            keypoints = np.column_stack([pixels, np.ones(len(pixels)), np.zeros(len(pixels))]).astype(np.float32)
            writer.write_keypoints(image.image_id, keypoints)
        for first in range(_CAMERAS):
            for second in range(first + 1, _CAMERAS):
                wrong = second - first in _WRONG
                shifted = seen[first][0] + (len(tile) if wrong else 0)
                _, left, right = np.intersect1d(shifted, seen[second][0], return_indices=True)
                if not wrong:  # a change of viewpoint costs matches
                    stays = rng.random(len(left)) < 0.5
                    left, right = left[stays], right[stays]
                if len(left) < 15:
                    continue
                pair = pycolmap.TwoViewGeometry()
                pair.config = pycolmap.TwoViewGeometryConfiguration.CALIBRATED
                pair.inlier_matches = np.stack([left, right], axis=1).astype(np.uint32)
                writer.write_two_view_geometry(first + 1, second + 1, pair)


def _slip(model: pycolmap.Reconstruction) -> float:
    """World units between centers after the best similarity."""
    images = sorted((image for image in model.images.values() if image.has_pose), key=lambda image: image.name)
    truth = _centers()[[int(image.name[:2]) for image in images]]
    estimated = np.array([image.projection_center() for image in images])
    return float(np.linalg.norm(fit_similarity(estimated, truth).points(estimated) - truth, axis=1).max())


def test_pairs_off_by_a_repeat_are_taken_out(tmp_path: Path) -> None:
    database = tmp_path / "features.db"
    _write_wall(database)
    (tmp_path / "usual").mkdir()
    usual = pycolmap.incremental_mapping(database, tmp_path, tmp_path / "usual", options=mapper_options())
    assert _slip(max(usual.values(), key=lambda model: model.num_reg_images())) > 0.3
    mapping = Mapping(
        database,
        tmp_path,
        tmp_path,
        [{"file": str(index)} for index in range(_CAMERAS)],
        lambda *_: None,
        lambda *_: None,
    )
    best, *_ = mapping.run(global_images=1_000).models
    assert best.num_reg_images() == _CAMERAS and _slip(best) < 0.02
