"""Laws of what no photo shows: hidden behind something in all photos, and no law of what photos do not look towards."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from fastsplat.service.query.edits.apply_edit import apply_edit
from fastsplat.service.query.objects.absence import ALL_SEEN, UnseenSpace
from fastsplat.service.query.objects.unseen_space import surface_kind, unseen_space
from fastsplat.service.scene.artefact.scene import Scene, SurfaceKind
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.messages.scenes import Edit
from tests.query.box_scenes import BoxShell, look, orbit, rigid, scene_of, with_cameras_moved
from tests.query.conftest import plain_index_of
from tests.query.walled_room import HEIGHT, OBJECTS, SCREEN, WALLS, from_corner

CARTON = BoxShell("carton", (0.9, 0.4, 0.2), (0.4, 0.4, 0.4), count=1200)


def inward() -> list[PosedCamera]:
    angles = np.arange(20) * 2 * np.pi / 20
    return [look((1.7 * np.cos(a), 1.2 * np.sin(a), 1.5), (0, 0, 0.2), f"{i}.jpg") for i, a in enumerate(angles)]


def from_behind() -> list[PosedCamera]:
    """Cameras that look behind the screen."""
    return [look((-1.5, -1.4, 1.8), (-1.5, y, 0.4), f"{y}.jpg") for y in (0.0, 0.4, 0.8, 1.2)]


def parts_of(scene: Scene) -> tuple[NDArray[np.int32], dict[int, SurfaceKind]]:
    """The label of each Gaussian, and which labels are surfaces."""
    kinds = {number: surface_kind(entry.label) for number, entry in enumerate(scene.dictionary.entries, start=1)}
    return scene.gaussians.codes.argmax(axis=1).astype(np.int32), kinds


def measured(boxes: Sequence[BoxShell], cameras: Sequence[PosedCamera]) -> UnseenSpace:
    scene = scene_of(boxes, cameras)
    return unseen_space(scene, *parts_of(scene))


def exactly(boxes: Sequence[BoxShell], cameras: Sequence[PosedCamera]) -> float:
    """The share by rays: of the points of the room that are in a picture, those that boxes hide in all pictures."""
    axes = [np.arange(low + 0.05, high, 0.1) for low, high in ((-2, 2), (-1.5, 1.5), (0, HEIGHT))]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    in_view, seen = np.zeros((2, len(points)), np.bool_)
    for posed in cameras:
        eye, inside = posed.world_from_camera[:3, 3], np.zeros(len(points), np.bool_)
        inside[posed.in_picture(points)[0]] = True
        free = inside.copy()
        for box in boxes:
            ends = [(np.add(box.centre, side * np.array(box.size) / 2) - eye) / (points - eye) for side in (-1, 1)]
            enters, leaves = np.minimum(*ends).max(axis=1), np.maximum(*ends).min(axis=1)
            free &= ~((enters < leaves) & (enters > 0) & (enters < 1))
        in_view |= inside
        seen |= free
    return float(1 - seen.sum() / in_view.sum())


@pytest.mark.parametrize("turn", range(3))
def test_the_share_is_what_rays_say(turn: int) -> None:
    rng = np.random.default_rng(turn)
    block = BoxShell("block", (-0.7, 0.3, 0.6), (rng.uniform(0.4, 1.0), rng.uniform(0.5, 1.2), 1.2), count=4000)
    screen = replace(SCREEN, centre=(rng.uniform(-1.2, -0.4), 0.3, 0.8))
    for hiding in (block, screen):
        boxes = [*OBJECTS, hiding]
        assert measured([*WALLS, *boxes], from_corner()).share == pytest.approx(exactly(boxes, from_corner()), abs=0.05)


def test_what_photos_show_from_somewhere_is_seen() -> None:
    for boxes in (OBJECTS, [*OBJECTS, CARTON]):
        assert not measured([*WALLS, *boxes], inward()).hides
        assert not measured([*WALLS, *boxes], from_corner()).hides
        table = BoxShell("table", (0, 0, -0.02), (2.4, 1.6, 0.04), count=3000)
        assert not measured([table, *boxes], orbit(16, 1.6, 1.0)).hides


def test_what_stands_behind_something_in_every_photo_is_not_seen() -> None:
    hidden = measured([*WALLS, *OBJECTS, SCREEN], from_corner())
    assert hidden.hides and hidden.behind[0] == 6  # of floor, wall, three objects and the screen
    # Photos from the other side, too, leave nothing.
    assert not measured([*WALLS, *OBJECTS, SCREEN], [*from_corner(), *from_behind()]).hides


def test_what_is_behind_the_walls_is_outside() -> None:
    """A wall between two rooms that both have walls hides the other room only while it counts as an object."""
    between = replace(WALLS[1], label="inner wall", centre=(0.0, 0.0, HEIGHT / 2))
    boxes = [*WALLS, *OBJECTS, between]
    cameras = [look((1.8, y, 1.5), (0.4, 0, 0.6), f"{y}.jpg") for y in (-1.0, -0.5, 0.0, 0.5, 1.0)]
    scene = scene_of(boxes, cameras)
    owner, kinds = parts_of(scene)
    assert unseen_space(scene, owner, kinds).hides
    assert not unseen_space(scene, owner, {**kinds, len(kinds): "wall"}).hides


def test_the_place_may_lie_and_be_measured_as_it_likes() -> None:
    boxes = [*WALLS, *OBJECTS, SCREEN]
    scene = scene_of(boxes, from_corner())
    owner, surfaces = parts_of(scene)
    share = unseen_space(scene, owner, surfaces).share
    pose = np.eye(4)
    pose[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    pose[:3, 3] = rigid(1)[:3, 3]
    for scale in (1.0, 7.5):
        means = (scale * (scene.gaussians.means @ pose[:3, :3].T + pose[:3, 3])).astype(np.float32)
        log_scales = scene.gaussians.log_scales + np.float32(np.log(scale))
        moved = with_cameras_moved(scene, pose)
        cameras = []
        for posed in moved.cameras:
            placed = posed.world_from_camera.copy()
            placed[:3, 3] *= scale
            cameras.append(replace(posed, world_from_camera=placed))
        moved = replace(
            moved, cameras=tuple(cameras), gaussians=replace(scene.gaussians, means=means, log_scales=log_scales)
        )
        assert unseen_space(moved, owner, surfaces).share == pytest.approx(share, abs=0.02)


def test_nothing_is_said_of_what_nobody_photographed() -> None:
    assert measured([*WALLS, *OBJECTS, SCREEN], []) == ALL_SEEN
    away = [look((1.7, -1.2, 1.5), (5.0, -5.0, 1.5), "away.jpg")]
    assert measured([*WALLS, *OBJECTS, SCREEN], away) == ALL_SEEN
    assert measured([BoxShell("mug", (0, 0, 0), (0.1, 0.1, 0.0), count=2)], orbit()) == ALL_SEEN
    flat = scene_of([BoxShell("mug", (0, 0, 0), (1.0, 1.0, 0.0))], orbit())
    assert unseen_space(flat, np.ones(300, np.int32), {}) == ALL_SEEN
    assert unseen_space(scene_of(OBJECTS, orbit()), np.zeros(900, np.int32), {}) == ALL_SEEN


@pytest.mark.parametrize("stored", [False, True])
def test_an_absence_is_said_only_where_enough_is_seen(stored: bool) -> None:
    for cameras, outcome in ((from_corner(), "not_seen"), ([*from_corner(), *from_behind()], "not_here")):
        index = plain_index_of(scene_of([*WALLS, *OBJECTS, SCREEN], cameras))
        if stored:
            index = plain_index_of(index.objects.scene)
        piano, mug = index.ask(["piano", "mug"])
        assert (piano.outcome, mug.outcome) == (outcome, "here")
        assert piano.is_absent and not piano.object_ids and not piano.relevant_ids
        if outcome == "not_seen":
            assert piano.probability is None
            assert piano.sentence.startswith('Not seen: none of the 6 names in this scene is "piano"; no photo shows ')
            assert piano.sentence.endswith(' % of the place, most of it behind or in "screen".')
        else:
            assert piano.sentence == 'Not here: none of the 6 names in this scene is "piano".'


def test_a_name_changes_nothing_that_was_seen() -> None:
    index = plain_index_of(plain_index_of(scene_of([*WALLS, *OBJECTS, SCREEN], from_corner())).objects.scene)
    (screen,) = index.ask(["screen"])[0].object_ids
    named = index.after(apply_edit(index, Edit("name", object_ids=(screen,), name="room divider")))
    assert named.objects.unseen is index.objects.unseen
    assert named.ask(["piano"])[0].sentence.endswith('behind or in "room divider".')
