"""Quaternions and frames."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fastsplat.api.cameras import orientation_of, posed_camera, position_of
from fastsplat.service.common.camera import Camera
from fastsplat.service.common.errors import InvalidInputError

_CAMERA = Camera(8, 6, 5.0, 5.0, 4.0, 3.0)
_number = st.floats(-1, 1)
_quaternions = st.tuples(_number, _number, _number, _number).filter(lambda q: np.linalg.norm(q) > 0.1)


def _unit(q: tuple[float, ...]) -> tuple[float, float, float, float]:
    x, y, z, w = np.array(q) / np.linalg.norm(q)
    return float(x), float(y), float(z), float(w)


@given(_quaternions)
def test_a_pose_survives_the_way_there_and_back(q: tuple[float, float, float, float]) -> None:
    unit = _unit(q)
    posed = posed_camera(_CAMERA, (1.0, 2.0, 3.0), unit, convention="OPENCV", frame_id="world", field="camera")
    again = orientation_of(posed)
    assert position_of(posed) == (1.0, 2.0, 3.0)
    assert again[3] >= 0
    assert min(np.abs(np.subtract(again, unit)).max(), np.abs(np.add(again, unit)).max()) < 1e-12


@given(_quaternions)
def test_the_matrix_turns_vectors_as_the_quaternion_does(q: tuple[float, float, float, float]) -> None:
    x, y, z, w = _unit(q)
    posed = posed_camera(_CAMERA, (0.0, 0.0, 0.0), (x, y, z, w), convention="OPENCV", frame_id="", field="camera")
    axis, vector = np.array([x, y, z]), np.array([0.3, -0.7, 0.2])
    turned = vector + 2 * np.cross(axis, np.cross(axis, vector) + w * vector)
    assert np.allclose(posed.world_from_camera[:3, :3] @ vector, turned, atol=1e-12)


def test_opengl_looks_along_minus_z_with_y_up() -> None:
    posed = posed_camera(_CAMERA, (0, 0, 0), (0, 0, 0, 1), convention="OPENGL", frame_id="world", field="camera")
    assert np.array_equal(posed.world_from_camera[:3, :3], np.diag([1.0, -1.0, -1.0]))


@pytest.mark.parametrize("q", [(0, 0, 0, 0), (0, 0, 0, 1.01), (0, 0, 0, float("nan")), (0, float("inf"), 0, 0)])
def test_only_unit_quaternions_are_taken(q: tuple[float, float, float, float]) -> None:
    with pytest.raises(InvalidInputError, match="length"):
        posed_camera(_CAMERA, (0, 0, 0), q, convention="OPENCV", frame_id="world", field="camera")
