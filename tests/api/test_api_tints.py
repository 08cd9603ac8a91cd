"""Pictures in which things glow, and pictures as JPEG: the same over both faces, with the things that the map shows."""

from __future__ import annotations

import io
from typing import Any

import grpc
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from fastsplat.service.application.service import SceneService
from fastsplat_client import Client
from fastsplat_contract.errors import FastSplatError
from fastsplat_contract.json_codec import to_plain
from fastsplat_contract.proto_codec import to_proto
from fastsplat_contract.queries import PictureRequest, Tint
from fastsplat_contract.scenes import Color
from tests.api.served import Faces, rest_refusal, rpc_refusal

_RED, _BLUE = Color(1.0, 0.0, 0.0), Color(0.0, 0.0, 1.0)


def _pixels(content: bytes) -> NDArray[np.float64]:
    return np.asarray(Image.open(io.BytesIO(content)).convert("RGB"), dtype=np.float64)


def test_tints_cover_their_things_and_dimming_the_rest(client: Client, scene_id: str) -> None:
    ids = client.thing_map(scene_id, "front.png")
    first, second = np.unique(ids[ids > 0])[:2].tolist()
    plain = _pixels(client.picture(scene_id, "rgb", "front.png"))
    tints = [Tint((first, second), _RED, 0.5), Tint((second,), _BLUE, 1.0)]
    shown = _pixels(client.picture(scene_id, "rgb", "front.png", tints=tints, dimming=0.25))
    expected = 0.75 * plain
    expected[ids == first] = 0.5 * plain[ids == first] + [127.5, 0, 0]
    expected[ids == second] = [0, 0, 255]
    assert np.abs(shown - expected).max() <= 1


def test_a_jpeg_is_the_picture_in_fewer_bytes(client: Client, scene_id: str) -> None:
    for kind in ("rgb", "depth_picture", "things"):
        exact = client.picture(scene_id, kind, "front.png")
        quick = client.picture(scene_id, kind, "front.png", image_format="jpeg")
        assert Image.open(io.BytesIO(quick)).format == "JPEG"
        assert np.abs(_pixels(quick) - _pixels(exact)).mean() < 8


def test_tinted_jpegs_are_the_same_bytes(faces: Faces, service: SceneService, scene_id: str) -> None:
    request = PictureRequest(
        scene_id, "rgb", view="front.png", format="jpeg", tints=(Tint((1,), _RED, 0.5),), dimming=0.5
    )
    truth = service.answers.picture(request)
    body = {name: value for name, value in to_plain(request).items() if name != "scene_id"}
    response = faces.rest.post(f"/v1/scenes/{scene_id}:render", json=body)
    assert response.headers["content-type"] == "image/jpeg" and response.content == truth
    assert b"".join(chunk.data for chunk in faces.rpc.RenderView(to_proto(request))) == truth


@pytest.mark.parametrize(
    ("more", "field"),
    [
        ({"kind": "depth", "format": "jpeg"}, "format"),
        ({"kind": "thing_map", "format": "jpeg"}, "format"),
        ({"kind": "mask", "text": "mug", "format": "jpeg"}, "format"),
        ({"kind": "rgb", "tints": (Tint((1, 60_000), _RED, 0.5),)}, "tints[0].things[1]"),
        ({"kind": "rgb", "tints": (Tint((), _RED, 0.5), Tint((-1,), _RED, 0.5))}, "tints[1].things[0]"),
        ({"kind": "things", "tints": (Tint((1,), _RED, 0.5),)}, "tints"),
        ({"kind": "depth", "dimming": 0.5}, "dimming"),
    ],
)
def test_what_cannot_be_drawn_is_refused_with_its_field(
    faces: Faces, service: SceneService, scene_id: str, more: dict[str, Any], field: str
) -> None:
    request = PictureRequest(scene_id, view="front.png", **more)
    with pytest.raises(FastSplatError) as in_process:
        service.answers.picture(request)
    body = {name: value for name, value in to_plain(request).items() if name != "scene_id"}
    over_rest = rest_refusal(faces.rest.post(f"/v1/scenes/{scene_id}:render", json=body))
    with pytest.raises(grpc.RpcError) as caught:
        list(faces.rpc.RenderView(to_proto(request)))
    over_grpc = rpc_refusal(caught.value)
    assert in_process.value.field == over_rest.details["field"] == over_grpc.details["field"] == field


@pytest.mark.parametrize("tint", [{"strength": 1.5}, {"color": {"r": 2.0, "g": 0.0, "b": 0.0}}, {"more": 1}])
def test_a_tint_out_of_bounds_is_refused(faces: Faces, scene_id: str, tint: dict[str, Any]) -> None:
    whole = {"things": [1], "color": {"r": 1.0, "g": 0.0, "b": 0.0}, "strength": 0.5, **tint}
    body = {"kind": "rgb", "view": "front.png", "tints": [whole]}
    assert faces.rest.post(f"/v1/scenes/{scene_id}:render", json=body).status_code == 400
