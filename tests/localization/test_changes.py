"""What changed between a scene and photos of another day is an event where two photos agree, and nowhere else."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from fastsplat.service.application.answering.scene_changes import _where_looked
from fastsplat.service.localization.changes import (
    COMPARED_SIDE,
    Change,
    Lost,
    find_changes,
    lost_objects,
    pixels_of,
    whole,
)
from fastsplat.service.localization.later_views import LaterView
from fastsplat.service.localization.photometric_refinement import compared
from fastsplat.service.query.drawing.scene_renderer import Renderer
from fastsplat.service.scene.artefact.scene import Scene
from fastsplat_contract.geometry.camera import PosedCamera
from tests.localization.textured_room import looking, renderer, textured_room

_FROM = ((-0.7, 1.0), (-0.45, 1.9), (-0.15, 1.2), (0.15, 2.3), (0.45, 1.2), (0.7, 1.9))
_VIEWS = tuple(looking(angle, height=height) for angle, height in _FROM)
_PLACE = np.array([[-0.1, -0.1, -0.1], [2.0, 2.0, 1.5]])
_WIDTH = 0.45
_AT = np.array([0.8, 0.8, 0.02])
_AWAY = np.array([-0.55, 0.1, 0.0])
_BLOCK = 4


def _moved(scene: Scene, by: NDArray[np.float64]) -> Scene:
    """The room with its block elsewhere: the block's Gaussians are the only ones of their color."""
    block = (scene.gaussians.sh[:, 0, 2] < -1.4) & (scene.gaussians.sh[:, 0, 0] > 1.5)
    means = scene.gaussians.means + block[:, None] * by.astype(np.float32)
    return replace(scene, gaussians=replace(scene.gaussians, means=means.astype(np.float32)))


@pytest.fixture(scope="module")
def empty() -> Renderer:
    return renderer(textured_room())


@pytest.fixture(scope="module")
def with_block() -> Renderer:
    return renderer(textured_room(block=True))


@pytest.fixture(scope="module")
def moved_block() -> Renderer:
    return renderer(_moved(textured_room(block=True), _AWAY))


def _recolored(scene: Scene, color: tuple[float, float, float]) -> Scene:
    """The room with a block of another color in the place of its own."""
    sh = scene.gaussians.sh.copy()
    sh[(sh[:, 0, 2] < -1.4) & (sh[:, 0, 0] > 1.5)] = color
    return replace(scene, gaussians=replace(scene.gaussians, sh=sh))


def _box(at: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.stack([at, at + _WIDTH])


def _assert_around(box: NDArray[np.float64] | None, truth: NDArray[np.float64], atol: float) -> None:
    assert box is not None
    np.testing.assert_allclose(box.mean(axis=0), truth.mean(axis=0), atol=atol)


def _events(
    scene: Renderer, empty: Renderer, photos: Sequence[NDArray[np.uint8]], boxes: dict[int, NDArray[np.float64]]
) -> tuple[Change, ...]:
    views = _later(scene, empty, photos)
    if _BLOCK not in boxes:
        views = [replace(view, objects=np.ones_like(view.objects)) for view in views]
    return find_changes(views, boxes, _PLACE, frozenset({1})).events


def _later(
    scene: Renderer, empty: Renderer, photos: Sequence[NDArray[np.uint8]], cameras: Sequence[PosedCamera] = _VIEWS
) -> list[LaterView]:
    """Photos beside the scene, whose objects are the room, 1, and the block."""
    views = []
    for posed, photo in zip(cameras, photos, strict=False):
        comparison = compared(photo, posed, scene.geometry, side=COMPARED_SIDE)
        block = (np.abs(scene.colors(posed).astype(int) - empty.colors(posed)) > 30).any(axis=2)
        views.append(LaterView(comparison, np.where(block, _BLOCK, 1).astype(np.int32)))
    return views


def _photos(of: Renderer, gain: float = 1.0) -> list[NDArray[np.uint8]]:
    return [(of.colors(posed) * gain).clip(0, 255).astype(np.uint8) for posed in _VIEWS]


def test_what_was_put_there_is_new_at_its_place(empty: Renderer, with_block: Renderer) -> None:
    (event,) = _events(empty, empty, _photos(with_block), {})
    assert event.kind == "new" and event.object_id == 0 and event.before is None and len(event.views) >= 4
    _assert_around(event.after, _box(_AT), 0.1)
    assert {region.kind for region in event.regions} == {"new"}


def test_what_is_new_before_what_is_nowhere_sure_is_new_all_the_same(empty: Renderer, with_block: Renderer) -> None:
    """As before a plain wall, of which no photo tells how far away it is."""
    views = [
        replace(view, comparison=replace(view.comparison, sure=np.zeros_like(view.comparison.sure)))
        for view in _later(empty, empty, _photos(with_block))
    ]
    (event,) = find_changes(views, {}, _PLACE).events
    assert event.kind == "new"


def test_the_middle_of_what_is_new_is_right_where_photos_see_one_side_of_it(
    empty: Renderer, with_block: Renderer
) -> None:
    side = [looking(angle, height=1.2) for angle in (0.0, 0.1, 0.2, 0.3)]
    views = _later(empty, empty, [with_block.colors(posed) for posed in side], side)
    (event,) = find_changes(views, {}, _PLACE).events
    _assert_around(event.after, _box(_AT), 0.06)


@pytest.mark.parametrize("found", [True, False])
def test_what_was_taken_away_is_gone(empty: Renderer, with_block: Renderer, found: bool) -> None:
    """Also where it was none of the scene's objects, and is not new there."""
    (event,) = _events(with_block, empty, _photos(empty), {_BLOCK: _box(_AT)} if found else {})
    assert event.kind == "gone" and event.object_id == (_BLOCK if found else 0) and event.after is None
    _assert_around(event.before, _box(_AT), 0.1)
    assert {region.kind for region in event.regions} == {"missing"}
    for region in event.regions if found else ():
        posed = _VIEWS[region.view]
        block = np.abs(with_block.colors(posed).astype(int) - empty.colors(posed)).max(axis=2) > 30
        rows, columns = np.nonzero(block)
        around = columns.min(), rows.min(), columns.max() + 1, rows.max() + 1
        np.testing.assert_allclose(region.box, around, atol=0.02 * max(block.shape))


@pytest.mark.parametrize("found", [True, False])
def test_what_was_put_elsewhere_has_moved(
    empty: Renderer, with_block: Renderer, moved_block: Renderer, found: bool
) -> None:
    """Also where it was none of the scene's objects."""
    boxes = {_BLOCK: _box(_AT)} if found else {}
    (event,) = _events(with_block, empty, _photos(moved_block), boxes)
    assert event.kind == "moved" and event.object_id == (_BLOCK if found else 0)
    _assert_around(event.before, _box(_AT), _WIDTH / 2)
    _assert_around(event.after, _box(_AT) + _AWAY, _WIDTH / 2)


def test_views_that_are_mostly_unsure_of_an_object_say_nothing_of_it(empty: Renderer, with_block: Renderer) -> None:
    views, boxes = _later(with_block, empty, _photos(empty)), {_BLOCK: _box(_AT)}
    lost, seen = lost_objects(views, boxes, frozenset())
    assert [loss.object_id for loss in lost] == seen == [_BLOCK]
    for share, known in ((0.4, []), (0.7, [_BLOCK])):
        some = []
        for view in views:
            pixels = np.flatnonzero((view.objects == _BLOCK) & view.comparison.sure)
            sure = view.comparison.sure.copy()
            sure.ravel()[pixels[int(share * (view.objects == _BLOCK).sum()) :]] = False
            some.append(LaterView(replace(view.comparison, sure=sure), view.objects))
        assert lost_objects(some, boxes, frozenset())[1] == known


def test_what_is_set_aside_of_no_object_is_the_surface_in_its_box(empty: Renderer, with_block: Renderer) -> None:
    views = _later(with_block, empty, _photos(empty))
    lost = Lost(_box(_AT) + np.array([[-0.02], [0.02]]), (0,), (), 1.0, 0, 0.5)
    for view, aside in zip(views, pixels_of(views, [lost]), strict=True):
        block = view.objects == _BLOCK
        assert (aside & block).sum() > 0.9 * (aside | block).sum()


def test_where_something_stands_out_more_it_has_changed(empty: Renderer, with_block: Renderer) -> None:
    """As a block does beside one of the color of the walls; where one stands out as much, it may be a dark gap."""
    dull = renderer(_recolored(textured_room(block=True), (0.0, 0.0, 0.0)))
    (event,) = _events(dull, empty, _photos(with_block), {_BLOCK: _box(_AT)})
    assert event.kind == "changed" and event.object_id == _BLOCK and event.before is not None
    _assert_around(event.after, _box(_AT), 0.1)
    dark = renderer(_recolored(textured_room(block=True), (-1.7, -1.7, -1.7)))
    (event,) = _events(with_block, empty, _photos(dark), {_BLOCK: _box(_AT)})
    assert event.kind == "gone" and event.object_id == _BLOCK


@pytest.mark.parametrize("gain", [0.62, 1.0, 1.3])
def test_a_place_in_other_light_has_not_changed(empty: Renderer, with_block: Renderer, gain: float) -> None:
    assert _events(with_block, empty, _photos(with_block, gain), {_BLOCK: _box(_AT)}) == ()


def test_a_shadow_is_no_event(empty: Renderer) -> None:
    """The same piece of the floor is darker in all photos."""
    photos = []
    shade = _moved(textured_room(block=True), np.array([0.0, 0.0, -0.43]))
    for posed, photo in zip(_VIEWS, _photos(empty), strict=True):
        on_floor = (np.abs(renderer(shade).colors(posed).astype(int) - empty.colors(posed)) > 30).any(axis=2)
        photos.append(np.where(on_floor[..., None], photo * 0.65, photo).astype(np.uint8))
    assert _events(empty, empty, photos, {}) == ()


def test_one_photo_alone_tells_of_no_event(empty: Renderer, with_block: Renderer) -> None:
    assert _events(with_block, empty, _photos(empty)[:1], {_BLOCK: _box(_AT)}) == ()


@pytest.mark.parametrize(("looked", "kinds"), [(True, ["new", "gone"]), (False, ["gone"])])
def test_what_stands_where_no_photo_of_the_scene_looked_is_not_new(looked: bool, kinds: list[str]) -> None:
    room, box = textured_room(), _box(_AT)
    if not looked:
        back = np.diag([-1.0, 1.0, -1.0, 1.0])
        away = [replace(posed, world_from_camera=posed.world_from_camera @ back) for posed in room.cameras]
        room = replace(room, cameras=(*away, room.cameras[0]))
    events = [Change("new", 0, (0, 1), 0.9, None, box, ()), Change("gone", _BLOCK, (0, 1), 0.9, box, None, ())]
    assert [event.kind for event in _where_looked(room, events)] == kinds


def test_a_piece_that_touches_what_is_lost_is_a_part_of_it() -> None:
    pixels = np.zeros((3, 40, 40), np.bool_)
    pixels[0, 5:15, 5:15], pixels[1, 5:15, 18:25], pixels[2, 30:35, 30:35] = True, True, True
    obj, beside, elsewhere = (
        Lost(_box(_AT), (0, 1), (mask, mask), 0.9, number, 0.5)
        for number, mask in zip((_BLOCK, 0, 0), pixels, strict=True)
    )
    assert whole([obj, beside, elsewhere]) == [obj, elsewhere]
    neighbor = replace(beside, object_id=_BLOCK + 1)
    assert whole([obj, neighbor, elsewhere]) == [obj, neighbor, elsewhere]
