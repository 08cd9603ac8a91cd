"""Twelve rooms by their names, drawn from seeds: nothing of them is stored.

`KIND-NUMBER` names a room; six are there to choose settings by, six are held out.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from benchmarks.rooms import kinds
from benchmarks.rooms.arranging import Room
from benchmarks.rooms.lighting import light_on
from benchmarks.rooms.pictures import EVEN, phone_faults, photo_of, picture_of
from benchmarks.rooms.rasterizing import Soup, soup_of
from benchmarks.rooms.shapes import F64, Ints, Mesh
from benchmarks.rooms.truth import RoomView, truth_of, write_truth
from fastsplat_contract.geometry.camera import Camera, PosedCamera

KINDS = {
    "desk": kinds.desk,
    "kitchen": kinds.kitchen,
    "workshop": kinds.workshop,
    "shelf": kinds.shelf,
    "tools": kinds.lying_tools,
    "chairs": kinds.chairs,
    "shop": kinds.shop,
    "toys": kinds.playroom,
}
ROOMS: Mapping[str, tuple[str, ...]] = {
    "validation": ("desk-1", "kitchen-1", "workshop-1", "shelf-1", "tools-1", "chairs-1"),
    "test": ("desk-2", "kitchen-2", "tools-2", "chairs-2", "shop-1", "toys-1"),
}
"""Names by what they are for: to choose settings by, or to measure once."""

WIDTH, HEIGHT = 480, 360
_FIELD_OF_VIEW = math.radians(60.0)  # horizontal
_TEST_EVERY, _FIRST_TEST = 5, 2


def room_of(name: str) -> tuple[Room, int]:
    """The room `KIND-NUMBER`, and the seed of its light and photos."""
    kind, number = name.split("-")
    seed = 100 * (1 + list(KINDS).index(kind)) + int(number)
    return KINDS[kind](np.random.default_rng(seed)), seed


def camera_of(width: int = WIDTH) -> Camera:
    """The lens of all photos, at a width in pixels; 4:3, 60 degrees."""
    focal = width / (2 * math.tan(_FIELD_OF_VIEW / 2))
    height = round(width * HEIGHT / WIDTH)
    return Camera(width, height, focal, focal, width / 2, height / 2)


class Studio:
    """A room with its triangles, their ids, and its light, with shadows as fine as photos of this width.

    Attributes:
        meshes: all of them.
        soup: their triangles.
        object_of, part_of: int64 [T], ids of the object and of the part (0 for none) of each triangle.
        parts: object and name of each part, from id 1.
    """

    def __init__(self, room: Room, seed: int, width: int = WIDTH) -> None:
        self.meshes: list[Mesh] = [mesh for obj in room.objects for mesh in obj.meshes]
        owners = [number for number, obj in enumerate(room.objects, start=1) for _ in obj.meshes]
        named = [(owner, mesh.part) for owner, mesh in zip(owners, self.meshes, strict=True)]
        self.parts = list(dict.fromkeys(pair for pair in named if pair[1]))
        self.soup: Soup = soup_of(self.meshes)
        self.object_of: Ints = np.array(owners)[self.soup.mesh]
        ids = [self.parts.index(pair) + 1 if pair[1] else 0 for pair in named]
        self.part_of: Ints = np.array(ids)[self.soup.mesh]
        objects = [
            mesh.points for obj in room.objects if obj.surface in ("", "horizontal surface") for mesh in obj.meshes
        ]
        self.light = light_on(self.soup, np.concatenate(objects), room.window, seed, width / WIDTH)

    def draw(self, posed: PosedCamera) -> RoomView:
        """A view, with the objects and parts that the centers of its pixels show."""
        picture = picture_of(self.meshes, self.soup, self.light, posed)
        ids = [np.where(picture.triangle >= 0, id_of[picture.triangle], 0) for id_of in (self.object_of, self.part_of)]
        return RoomView(posed, picture.light, ids[0].astype(np.uint8), ids[1].astype(np.uint8), picture.nearness)


def write_room(name: str, folder: Path, *, views: int | None = None, width: int = WIDTH) -> None:
    """Draw a room's photos with their truth: a `transforms.json` as nerfstudio's, and `truth.npz`.

    Training photos have a phone's faults; those to measure by are taken in even light. The folder is as of
    `demo/sample/README.md`, and has `parts/` with ids of parts; with `views`, of only so many.
    """
    room, seed = room_of(name)
    studio, camera, rng = Studio(room, seed, width), camera_of(width), np.random.default_rng([seed, 1])
    for part in ("images", "instances", "parts"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    frames: list[dict[str, Any]] = []
    train: list[RoomView] = []
    test: list[RoomView] = []
    for number, pose in enumerate(room.poses[:views]):
        file = f"{number:03d}"
        picture = studio.draw(PosedCamera(camera, pose, f"images/{file}.jpg"))
        tested = number % _TEST_EVERY == _FIRST_TEST
        photo = photo_of(picture.light, EVEN if tested else phone_faults(rng), rng)
        Image.fromarray(photo).save(folder / "images" / f"{file}.jpg", quality=92)
        Image.fromarray(picture.objects).save(folder / "instances" / f"{file}.png")
        Image.fromarray(picture.parts).save(folder / "parts" / f"{file}.png")
        paths = {"file_path": f"images/{file}.jpg", "instance_path": f"instances/{file}.png"}
        frames.append({**paths, "part_path": f"parts/{file}.png", "transform_matrix": _opengl(pose).tolist()})
        (test if tested else train).append(picture)
    names = [[view.posed.name for view in views] for views in (train, test)]
    document = {
        "camera_model": "PINHOLE",
        "fl_x": camera.fx,
        "fl_y": camera.fy,
        "cx": camera.cx,
        "cy": camera.cy,
        "w": camera.width,
        "h": camera.height,
        "instances": [obj.label for obj in room.objects],
        "parts": [{"object": obj, "name": part} for obj, part in studio.parts],
        "train_filenames": names[0],
        "test_filenames": names[1],
        "frames": frames,
    }
    write_truth(
        truth_of(room, studio.soup, studio.object_of, [part for _, part in studio.parts], train, test),
        folder / "truth.npz",
    )
    (folder / "transforms.json").write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


def _opengl(pose: F64) -> F64:
    return pose @ np.diag([1.0, -1.0, -1.0, 1.0])
