"""Two captures of one place in one frame: by the photos of one, and only where enough of them agree."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from fastsplat.cli.main import app
from fastsplat.service.application.editing.shared_frame import _check_agreement
from fastsplat.service.application.service import SceneService
from fastsplat.service.common.similarity import Similarity
from fastsplat.service.perception.text.open_text_encoder import open_text_encoder
from fastsplat.service.query.edits.aligning import placed_gaussians
from fastsplat.service.query.settings import QuerySettings
from fastsplat.service.settings import Settings
from fastsplat_client import Client
from fastsplat_contract.errors import FastSplatError, InvalidInputError, NotFoundError, NotReadyError
from fastsplat_contract.proto_codec import from_proto, to_proto
from fastsplat_contract.requests import AlignToSceneRequest
from fastsplat_contract.scenes import SceneVersion
from tests.api.made_scene import ENCODER, LABELS
from tests.api.served import Faces
from tests.localization.textured_room import renderer, textured_room
from tests.scenes import add_photos, store_scene

_TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
_ELSEWHERE = Similarity(1.0, _TURN, np.array([3.0, -2.0, 0.5]))

AddRoom = Callable[..., str]


@pytest.fixture
def add_room(service: SceneService, api_settings: Settings) -> AddRoom:
    """Adds a capture of a room, in meters unless said otherwise, in a frame of its own."""
    encoder = open_text_encoder(ENCODER, api_settings.models)

    def add(seed: int = 0, frame: Similarity | None = None, **others: Any) -> str:
        others = {"scale": "METRIC", **others}
        scene = textured_room(
            seed, labels=LABELS, encoder=encoder, templates=QuerySettings().templates, block=True, **others
        )
        drawn = renderer(scene)
        pictures = [Image.fromarray(drawn.colors(posed)) for posed in scene.cameras]
        if frame is not None:
            cameras = tuple(map(frame.camera, scene.cameras))
            scene = replace(scene, gaussians=placed_gaussians(scene.gaussians, frame), cameras=cameras)
        made = store_scene(service._store, scene, "room")
        add_photos(service._store, made, pictures)
        return made

    return add


@pytest.mark.parametrize("size", [1.0, 0.4], ids=["meters", "units of 2.5 m"])
def test_a_scene_is_put_where_the_other_capture_is(
    faces: Faces, service: SceneService, client: Client, add_room: AddRoom, size: float
) -> None:
    first = add_room()
    frame = replace(_ELSEWHERE, scale=size)
    second = add_room(frame=frame, scale="METRIC" if size == 1.0 else "ARBITRARY")
    made = client.align_to(second, first, request_id="together")
    assert client.align_to(second, first, request_id="together").version == made.version
    there, here = client.scene(first), client.scene(second)
    assert here.alignment is not None and here.alignment.frame == first and here.scale == "METRIC"
    assert here.alignment.rms is not None and here.alignment.rms < 0.02
    assert here.alignment.pairs - len(here.alignment.outliers) >= 30
    for one, other in zip(here.cameras, there.cameras, strict=True):
        np.testing.assert_allclose(one.world_from_camera, other.world_from_camera, atol=0.02)
    client.undo_edit(second)
    assert client.scene(second).alignment is None
    over_grpc = faces.rpc.AlignToScene(to_proto(AlignToSceneRequest(second, first)))
    assert from_proto(SceneVersion, over_grpc).parent == made.parent
    # A third capture is put into the frame that both are in.
    third = add_room(frame=_ELSEWHERE)
    words = ["scenes", "align-to", third, second, "--server", str(faces.rest.base_url)]
    printed = CliRunner().invoke(app, words)
    assert f"frame {first}," in printed.stdout, printed.output
    for scene_id in (first, second, third):
        service.delete_scene(scene_id)


def test_what_has_no_common_frame_is_refused_and_stays(
    service: SceneService, client: Client, add_room: AddRoom
) -> None:
    room, other, unscaled = add_room(), add_room(seed=1), add_room(scale="ARBITRARY")
    cases: list[tuple[str, type[FastSplatError], str]] = [
        (other, InvalidInputError, "find their place in the other"),
        (room, InvalidInputError, "own frame"),
        (unscaled, NotReadyError, "no meters"),
        ("nothing", NotFoundError, "no scene"),
    ]
    for target, error, match in cases:
        with pytest.raises(error, match=match) as caught:
            client.align_to(room, target)
        assert caught.value.field.startswith("other"), target
    assert client.scene(room).alignment is None
    assert len(client.versions(room)) == 1
    for scene_id in (room, other, unscaled):
        service.delete_scene(scene_id)


def test_photos_agree_only_if_three_do_and_half_of_them() -> None:
    rng = np.random.default_rng(0)

    def photo(places: int, off: float) -> list[tuple[np.ndarray, np.ndarray]]:
        points = rng.uniform(-1, 1, (places, 3))
        return list(zip(points, _ELSEWHERE.points(points) + rng.uniform(-off, off, (places, 3)), strict=True))

    _check_agreement([photo(12, 1e-4) for _ in range(3)], False, 3)
    for right, wrong in ((2, 0), (2, 2), (3, 4)):
        pairs = [*(photo(12, 1e-4) for _ in range(right)), *(photo(2, 1.0) for _ in range(wrong))]
        with pytest.raises(InvalidInputError, match=f"{right} of {right + wrong} photos"):
            _check_agreement(pairs, False, right + wrong)
