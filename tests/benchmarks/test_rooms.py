"""Drawn rooms: the same seed gives the same pixels, ids are exact, and what is hard is there."""

from __future__ import annotations

from functools import cache
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import binary_dilation

from benchmarks.evaluation.datasets.reading import read_dataset
from benchmarks.rooms.arranging import HARD, Room
from benchmarks.rooms.drawing import ROOMS, Studio, camera_of, room_of, write_room
from benchmarks.rooms.pictures import EVEN, phone_faults, photo_of
from benchmarks.rooms.rasterizing import projected_into, rasterized, soup_of
from benchmarks.rooms.shapes import Meshes
from benchmarks.rooms.truth import RoomView, read_truth
from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat_contract.geometry.camera import PosedCamera

_WIDTH = 64
_ALIKE = ("tools-1", "tools-2")
_VIEWS = 4


@cache
def _room(name: str) -> Room:
    return room_of(name)[0]


@cache
def _studio() -> Studio:
    return Studio(*room_of("tools-1"), _WIDTH)


@cache
def _view() -> RoomView:
    return _studio().draw(PosedCamera(camera_of(_WIDTH), _room("tools-1").poses[2], "2.jpg"))


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A room, drawn and written by the program itself."""
    folder = tmp_path_factory.mktemp("rooms") / "tools-1"
    write_room("tools-1", folder, views=_VIEWS, width=_WIDTH)
    return folder


def test_the_same_seed_gives_the_same_pixels_and_another_room_others(written: Path) -> None:
    drawn = photo_of(_view().light, EVEN, np.random.default_rng(0))
    encoded = BytesIO()
    Image.fromarray(drawn).save(encoded, "JPEG", quality=92)
    assert (written / "images" / "002.jpg").read_bytes() == encoded.getvalue()
    assert np.array_equal(np.asarray(Image.open(written / "instances" / "002.png")), _view().objects)
    first, second = (soup_of([mesh for obj in _room(name).objects for mesh in obj.meshes]) for name in _ALIKE)
    assert not np.array_equal(first.points, second.points)


def test_ids_are_exact() -> None:
    """A pixel shows an object just where the object, drawn alone, is as near as anything is."""
    studio, drawing = _studio(), _view()
    projected, front, size = projected_into(studio.soup, drawing.posed.camera, drawing.posed.camera_from_world())
    nearest = np.zeros(size)
    for number in range(1, len(_room("tools-1").objects) + 1):
        alone = rasterized(projected, studio.soup.triangles, front & (studio.object_of == number), size)
        mask = drawing.objects == number
        assert np.allclose(alone.nearness[mask], drawing.nearness[mask], rtol=1e-6)
        assert (alone.nearness[~mask] <= drawing.nearness[~mask] + 1e-6).all()
        nearest = np.maximum(nearest, alone.nearness)
    assert np.allclose(nearest, drawing.nearness, rtol=1e-6) and (drawing.objects > 0).mean() > 0.9


def test_a_part_lies_in_its_object() -> None:
    studio, drawing = _studio(), _view()
    owners = np.array([0, *(obj for obj, _ in studio.parts)])
    assert (drawing.parts > 0).any()
    assert np.array_equal(owners[drawing.parts][drawing.parts > 0], drawing.objects[drawing.parts > 0])
    assert all(name and mesh.part in ("", name) for obj, name in studio.parts for mesh in _named(obj, name))


def _named(obj: int, name: str) -> Meshes:
    meshes = [mesh for mesh in _room("tools-1").objects[obj - 1].meshes if mesh.part == name]
    assert meshes
    return meshes


def test_what_is_written_is_read_again_with_its_poses_ids_and_truth(written: Path) -> None:
    dataset, truth = read_dataset(written, CaptureSettings()), read_truth(written / "truth.npz")
    room = _room("tools-1")
    assert truth.labels == dataset.instances == tuple(obj.label for obj in room.objects)
    assert len(dataset.train) + len(dataset.test) == _VIEWS and truth.names == tuple(v.name for v in dataset.test)
    for place, view in enumerate(dataset.test):
        assert np.allclose(view.posed.world_from_camera, room.poses[int(Path(view.name).stem)], atol=1e-9)
        alone = truth.silhouettes[place]
        seen = view.instances > 0
        assert alone[view.instances[seen] - 1, *np.nonzero(seen)].all()
        near = binary_dilation(alone, np.ones((1, 3, 3)))  # points on an edge may fall into the pixel beside it
        rows, pixels, _ = view.posed.in_picture(truth.points)
        x, y = pixels.astype(int).T
        assert near[truth.owners[rows] - 1, y, x].mean() > 0.95
    for number in range(1, len(room.objects) + 1):
        points = truth.points[truth.owners == number].astype(float)
        assert not truth.outside(number, points, 1e-5).any()


@pytest.mark.parametrize("split", ROOMS)
def test_every_hard_case_is_there(split: str) -> None:
    noted = {why for name in ROOMS[split] for why in _room(name).hard}
    assert noted == set(HARD)


def test_a_phones_photos_differ_in_light_within_bounds_and_even_ones_do_not() -> None:
    faults = [phone_faults(np.random.default_rng(seed)) for seed in range(200)]
    assert all(abs(fault.ev) <= 1.2 and max(abs(gain - 1) for gain in fault.balance) <= 0.06 for fault in faults)
    assert np.ptp([fault.ev for fault in faults]) > 2 and np.ptp([fault.balance[0] for fault in faults]) > 0.1
    gray = np.full((20, 30, 3), 0.2, np.float32)
    even = photo_of(gray, EVEN, np.random.default_rng(0))
    assert (even == even[0, 0]).all()
    assert photo_of(gray, faults[0], np.random.default_rng(0)).std() > 0
