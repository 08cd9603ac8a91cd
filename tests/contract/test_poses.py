"""Quaternions and frames: cameras on the wire, and as matrices."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fastsplat_contract.codec.json_codec import from_plain
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.geometry.poses import Quaternion, unit_quaternion

_INTRINSICS = {"width": 8, "height": 6, "fx": 5.0, "fy": 5.0, "cx": 4.0, "cy": 3.0}
_number = st.floats(-1, 1)
_quaternions = st.tuples(_number, _number, _number, _number).filter(lambda q: np.linalg.norm(q) > 0.1)


def _posed(position: tuple[float, ...], q: tuple[float, ...], **more: str) -> PosedCamera:
    plain = {
        "intrinsics": _INTRINSICS,
        "position": dict(zip("xyz", position, strict=True)),
        "orientation": dict(zip("xyzw", q, strict=True)),
    }
    return from_plain(PosedCamera, {**plain, **more}, "camera")


@given(_quaternions)
def test_a_matrix_turns_as_its_quaternion_does_and_gives_it_back(q: tuple[float, float, float, float]) -> None:
    x, y, z, w = (np.array(q) / np.linalg.norm(q)).tolist()
    posed = _posed((1.0, 2.0, 3.0), (x, y, z, w), frame_id="")
    axis, vector = np.array([x, y, z]), np.array([0.3, -0.7, 0.2])
    turned = vector + 2 * np.cross(axis, np.cross(axis, vector) + w * vector)
    assert np.allclose(posed.world_from_camera[:3, :3] @ vector, turned, atol=1e-12)
    sent = posed.to_wire()
    assert sent.position == (1.0, 2.0, 3.0) and sent.orientation.w >= 0
    side = np.copysign(1.0, np.dot(sent.orientation, (x, y, z, w)))
    assert np.allclose(np.multiply(side, sent.orientation), (x, y, z, w), rtol=0, atol=1e-12)


def test_opengl_looks_along_minus_z_with_y_up() -> None:
    posed = _posed((0, 0, 0), (0, 0, 0, 1), convention="OPENGL")
    assert np.array_equal(posed.world_from_camera[:3, :3], np.diag([1.0, -1.0, -1.0]))


@pytest.mark.parametrize("q", [(0, 0, 0, 0), (0, 0, 0, 1.01), (0, 0, 0, float("nan")), (0, float("inf"), 0, 0)])
def test_only_unit_quaternions_are_taken(q: tuple[float, float, float, float]) -> None:
    with pytest.raises(InvalidInputError, match="length"):
        unit_quaternion(Quaternion(*q))
    with pytest.raises(InvalidInputError) as caught:
        _posed((0, 0, 0), q)
    assert caught.value.field.startswith("camera.orientation")


def test_a_pose_off_by_rounding_becomes_a_rotation() -> None:
    posed = _posed((0, 0, 0), (0, 0, 0, 1.0009))
    assert np.abs(posed.world_from_camera[:3, :3] - np.eye(3)).max() < 1e-12
