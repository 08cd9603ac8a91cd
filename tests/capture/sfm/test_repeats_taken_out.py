"""A wall whose pattern repeats misleads the usual mapping; without the pairs that contradict others it is right."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pycolmap
from numpy.typing import NDArray

from fastsplat.service.capture.sfm.mapping import Mapping, mapper_options
from fastsplat.service.common.similarity import fit_similarity

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
