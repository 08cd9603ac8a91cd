"""What is withheld of a photo is withheld of its depth map."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fastsplat.service.capture.formats.depth_maps import load_depth
from fastsplat.service.capture.photos.camera_model import CameraModel, compute_undistortion
from fastsplat.service.capture.views.view_writer import DEPTHS, IMAGES, MASKS, SourceImage, write_view
from fastsplat_contract.geometry.camera import Camera


@pytest.mark.parametrize("shrink", [0.25, 1.0, 2.0])
def test_depths_under_a_mask_change_nothing(tmp_path: Path, shrink: float) -> None:
    width, height = 64, 48
    small = Camera(
        round(width * shrink), round(height * shrink), 50.0 * shrink, 50.0 * shrink, 32.0 * shrink, 24.0 * shrink
    )
    mask = np.ones((height, width), bool)
    mask[11:30, 21:41] = False
    rng = np.random.default_rng(0)
    stored = []
    for attempt in range(2):
        folder = tmp_path / str(attempt)
        for name in (IMAGES, MASKS, DEPTHS):
            (folder / name).mkdir(parents=True)
        depth = np.full((small.height, small.width), 2.0, np.float32)
        y, x = np.mgrid[: small.height, : small.width]
        inside = (x + 1 > 21 * shrink) & (x < 41 * shrink) & (y + 1 > 11 * shrink) & (y < 30 * shrink)
        depth[inside] = rng.uniform(0.5, 1.5, int(inside.sum()))
        model = CameraModel("PINHOLE", width, height, (50.0, 50.0, 32.0, 24.0))
        undistortion = compute_undistortion(model, 1000, field="a")
        pixels = np.zeros((height, width, 3), np.uint8)
        written = write_view(
            SourceImage("a", pixels, undistortion, np.eye(4), mask=mask, depth=(depth, small)), 0, folder
        )
        assert written is not None and written[0].depth is not None
        stored.append(load_depth(written[0].depth))
        assert not stored[-1][inside].any() and stored[-1][0, 0] == pytest.approx(2.0)
    np.testing.assert_array_equal(*stored)
