"""What a capture saw of a place: that it is empty, that something is there, or nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fastsplat.service.query.things.place_sight import place_sights
from fastsplat.service.scene.types import Scene
from fastsplat_contract.poses import look_at
from tests.localization.textured_room import CAMERA, textured_room

_LABELS = ("left wall", "back wall", "floor", "cube")


def _cube() -> np.ndarray:
    """float64 [K, 3], the Gaussians of the cube."""
    shape = textured_room(block=True, labels=_LABELS).gaussians.means.astype(np.float64)
    return shape[len(textured_room().gaussians.means) :]


def _looking_up(scene: Scene) -> Scene:
    """With the same cameras, none of which has the floor in its picture."""
    turned = (
        replace(
            each,
            camera=CAMERA,
            world_from_camera=look_at(
                each.world_from_camera[:3, 3], each.world_from_camera[:3, 3] * [0.2, 0.2, 1.0] + [0.0, 0.0, 3.0]
            ),
        )
        for each in scene.cameras
    )
    return replace(scene, cameras=tuple(turned))


@pytest.mark.parametrize(
    ("scene", "seen"),
    [
        (textured_room(), "empty"),
        (textured_room(block=True), "filled"),
        (_looking_up(textured_room()), "unseen"),
        (replace(textured_room(), cameras=()), "unseen"),
    ],
    ids=["nothing is there", "the cube is there", "no picture has it", "no cameras"],
)
def test_a_place_is_empty_filled_or_unseen(scene: Scene, seen: str) -> None:
    assert place_sights(scene, [_cube()]) == (seen,)


def test_what_is_hidden_is_unseen() -> None:
    """The inside of a cube, of a capture that has one there."""
    cube = _cube()
    inside = cube.mean(axis=0) + 0.3 * (cube - cube.mean(axis=0))
    assert place_sights(textured_room(block=True), [inside]) == ("unseen",)
    assert place_sights(textured_room(), [inside]) == ("empty",)


def test_before_nothing_a_place_is_unseen() -> None:
    """Where nothing was reconstructed behind it, nothing says that one looked through."""
    room = textured_room()
    far = np.linalg.norm(room.gaussians.means, axis=1) > 100.0
    bare = replace(
        room, gaussians=replace(room.gaussians, **{name: values[far] for name, values in vars(room.gaussians).items()})
    )
    assert place_sights(bare, [_cube()]) == ("unseen",)


def test_places_that_are_asked_together_are_told_apart() -> None:
    cube = _cube()
    behind = cube.mean(axis=0) + 0.3 * (cube - cube.mean(axis=0))
    aside = cube[:5] + np.array([0.0, 0.0, 1.5])
    room = textured_room(block=True)
    together = place_sights(room, [cube, behind, aside])
    assert together == tuple(one for each in (cube, behind, aside) for one in place_sights(room, [each]))
    assert together == ("filled", "unseen", "empty")
    assert place_sights(room, []) == ()


def test_a_place_of_which_little_is_to_be_seen_is_unseen() -> None:
    cube = _cube()
    within = [share * (cube - cube.mean(axis=0)) + cube.mean(axis=0) for share in (0.1, 0.2, 0.3, 0.4)]
    room = textured_room(block=True)
    assert place_sights(room, [cube, np.concatenate([cube, *within])]) == ("filled", "unseen")
