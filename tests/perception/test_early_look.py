"""The order in which views show a place soonest."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fastsplat.service.capture.captures import Capture, CaptureReport, View
from fastsplat.service.perception.label_maps.early_look import covering_order
from fastsplat_contract.geometry.camera import Camera, PosedCamera


def _view(x: float, width: int) -> View:
    pose = np.eye(4)
    pose[0, 3] = x
    return View(PosedCamera(Camera(width, 40, 40.0, 40.0, width / 2, 20.0), pose, f"{x}"), Path("none.png"))


def test_each_view_adds_as_many_points_as_it_can() -> None:
    """Every point counts twice, as an object is what two views show; views that add nothing keep their order behind."""
    row = np.linspace(-4, 4, 81)
    points = np.stack([row, np.zeros(81), np.full(81, 4.0)], axis=1).astype(np.float32)
    views = (_view(-3.0, 20), _view(0.0, 70), _view(0.0, 70), _view(0.0, 70), _view(3.0, 20))
    capture = Capture(views, points, np.zeros((81, 3), np.uint8), "METRIC", CaptureReport("images", len(views)))
    order = covering_order(capture, range(len(views)))
    assert order == [1, 2, 0, 4, 3]
    assert covering_order(capture, [4, 3, 0]) == [3, 4, 0]
    assert covering_order(capture, []) == []
