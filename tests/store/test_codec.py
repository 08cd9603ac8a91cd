"""JSON columns: what is written is read back as it was."""

from __future__ import annotations

import json

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fastsplat.service.store.rows.codec import camera_from_json, camera_to_json
from fastsplat_contract.geometry.camera import Camera, PosedCamera

_COORDINATE = st.floats(-1e6, 1e6)


@given(st.tuples(_COORDINATE, _COORDINATE, _COORDINATE), st.tuples(_COORDINATE, _COORDINATE, _COORDINATE))
def test_cameras_come_back_to_the_bit(rotation: tuple[float, ...], position: tuple[float, ...]) -> None:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.from_rotvec(rotation).as_matrix(), position
    posed = PosedCamera(Camera(480, 360, 500.1, 499.9, 240.5, 179.5), pose, "a.png")
    back = camera_from_json(json.loads(json.dumps(camera_to_json(posed))))
    assert (back.camera, back.name) == (posed.camera, posed.name)
    assert back.world_from_camera.tobytes() == posed.world_from_camera.tobytes()
