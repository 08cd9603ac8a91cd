"""Camera files for other programs."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from fastsplat.service.scene.formats.colmap_writing import colmap_text_model
from fastsplat.service.scene.formats.zips import zipped
from fastsplat_contract.codec.json_codec import to_plain
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.geometry.camera import OPENCV_FROM_OPENGL, PosedCamera


def camera_list(cameras: Sequence[PosedCamera]) -> bytes:
    """JSON of {"cameras": [...]}, each as in the REST interface."""
    return _json({"cameras": [to_plain(posed) for posed in cameras]})


def transforms(cameras: Sequence[PosedCamera], **more: Any) -> bytes:
    """nerfstudio's transforms.json: world-from-camera, OpenGL axes, intrinsics per frame.

    `more` are further top-level entries.
    """
    return _json({"camera_model": "OPENCV", **more, "frames": [_frame(posed) for posed in cameras]})


def _frame(posed: PosedCamera) -> dict[str, Any]:
    lens = posed.camera
    return {
        "file_path": posed.name,
        "w": lens.width,
        "h": lens.height,
        "fl_x": lens.fx,
        "fl_y": lens.fy,
        "cx": lens.cx,
        "cy": lens.cy,
        "transform_matrix": (posed.world_from_camera @ OPENCV_FROM_OPENGL).tolist(),
    }


def colmap(cameras: Sequence[PosedCamera]) -> bytes:
    """Zip of COLMAP's text model without points, one PINHOLE camera per distinct lens.

    Poses are camera-from-world, quaternions w x y z. Raises `InvalidInputError` for a name with blanks.
    """
    for posed in cameras:
        if any(letter.isspace() for letter in posed.name):
            raise InvalidInputError(
                f"COLMAP's text files cannot hold the image name {posed.name[:80]!r}",
                field="format",
                hint='Its names have no blanks; ask for "transforms" or "camera_list".',
            )
    return zipped(colmap_text_model(cameras))


def _json(value: dict[str, Any]) -> bytes:
    return (json.dumps(value, indent=1, allow_nan=False, ensure_ascii=False) + "\n").encode()
