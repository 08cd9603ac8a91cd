"""Pictures with glowing objects, and as JPEG: the same over both faces, with the objects that the map shows."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from fastsplat_client import Client
from fastsplat_contract.messages.scenes import Color
from fastsplat_contract.photos.pictures import Tint
from tests.api.served import Faces

_RED, _BLUE = Color(1.0, 0.0, 0.0), Color(0.0, 0.0, 1.0)


def _pixels(content: bytes) -> NDArray[np.float64]:
    return np.asarray(Image.open(io.BytesIO(content)).convert("RGB"), dtype=np.float64)


def test_tints_cover_their_objects_and_dimming_the_rest(client: Client, scene_id: str) -> None:
    ids = client.object_map(scene_id, "front.png")
    first, second = np.unique(ids[ids > 0])[:2].tolist()
    plain = _pixels(client.picture(scene_id, "rgb", "front.png"))
    tints = [Tint((first, second), _RED, 0.5), Tint((second,), _BLUE, 1.0)]
    pixels = _pixels(client.picture(scene_id, "rgb", "front.png", tints=tints, dimming=0.25))
    expected = 0.75 * plain
    expected[ids == first] = 0.5 * plain[ids == first] + [127.5, 0, 0]
    expected[ids == second] = [0, 0, 255]
    assert np.abs(pixels - expected).max() <= 1


def test_a_jpeg_is_the_picture_in_fewer_bytes(client: Client, scene_id: str) -> None:
    for kind in ("rgb", "depth_picture", "objects"):
        exact = client.picture(scene_id, kind, "front.png")
        quick = client.picture(scene_id, kind, "front.png", image_format="jpeg")
        assert Image.open(io.BytesIO(quick)).format == "JPEG"
        assert np.abs(_pixels(quick) - _pixels(exact)).mean() < 8


@pytest.mark.parametrize("tint", [{"strength": 1.5}, {"color": {"r": 2.0, "g": 0.0, "b": 0.0}}, {"more": 1}])
def test_a_tint_out_of_bounds_is_refused(faces: Faces, scene_id: str, tint: dict[str, Any]) -> None:
    whole = {"object_ids": [1], "color": {"r": 1.0, "g": 0.0, "b": 0.0}, "strength": 0.5, **tint}
    body = {"kind": "rgb", "view": "front.png", "tints": [whole]}
    assert faces.rest.post(f"/v1/scenes/{scene_id}:render", json=body).status_code == 400
