"""Rooms whose objects have printed words on them, with the place and the height of every line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from benchmarks.evaluation.negative_nouns import negative_nouns
from benchmarks.rooms.arranging import Ground, Room, extent
from benchmarks.rooms.groups import photographed
from benchmarks.rooms.materials import F32, mottled, painted, plain
from benchmarks.rooms.models.tableware import Random
from benchmarks.rooms.shapes import F64, Meshes, box, placed, sheet
from benchmarks.rooms.truth import RoomView
from demo.sample_paint import hex_rgb
from fastsplat.service.scene.artefact.scene import Gaussians, Object, Objects
from fastsplat.service.scene.objects.label_evidence import UNIT, evidence_of
from fastsplat_contract.geometry.camera import PosedCamera

DOTS = 2_500
"""Of a label, a meter."""
_GROUNDS = (
    ("#f3ead2", "#2a2320"),
    ("#e9efe4", "#1d3a2a"),
    ("#23324a", "#f1e9d8"),
    ("#7a2626", "#f6efe0"),
    ("#e2b84b", "#222222"),
)
_FACES = (
    cv2.FONT_HERSHEY_DUPLEX,
    cv2.FONT_HERSHEY_COMPLEX,
    cv2.FONT_HERSHEY_TRIPLEX,
    cv2.FONT_HERSHEY_COMPLEX | cv2.FONT_ITALIC,
)
_CAPITALS = (0.014, 0.034)
"""Meters, the least and the largest height of capitals."""
_MARGIN = 0.012
_LEAST_STRETCH = 0.5
"""Of what a line's breadth would be beside its height if it were seen from before it."""
_NEAR = 0.02


@dataclass(frozen=True)
class Line:
    """A printed line.

    Attributes:
        obj: its id in the room.
        text: what it says.
        corners: float64 [4, 3], of its capitals' height and its breadth: from the top left clockwise, meters.
    """

    object_id: int
    text: str
    corners: F64

    def height_in(self, view: RoomView) -> float:
        """How high its capitals are in a view, pixels; 0 where it is not wholly seen, or much from the side."""
        pixels, depth = _projected(view.posed, self._samples())
        size = (view.posed.camera.width, view.posed.camera.height)
        if (depth < 0.05).any() or (pixels < 1).any() or (pixels > np.array(size) - 2).any():
            return 0.0
        columns, rows = np.round(pixels - 0.5).astype(int).T
        seen = (view.objects[rows, columns] == self.object_id) & (view.nearness[rows, columns] * depth < 1 + _NEAR)
        top, right, bottom, left = _projected(view.posed, (self.corners + np.roll(self.corners, -1, axis=0)) / 2)[0]
        high, wide = float(np.linalg.norm(bottom - top)), float(np.linalg.norm(right - left))
        shape = np.linalg.norm(self.corners[1] - self.corners[0]) / np.linalg.norm(self.corners[3] - self.corners[0])
        return high if seen.all() and wide >= _LEAST_STRETCH * shape * high else 0.0

    def _samples(self) -> F64:
        u, v = (grid.reshape(-1, 1) for grid in np.meshgrid(np.linspace(0, 1, 9), np.linspace(0, 1, 3)))
        a, b, c, d = self.corners
        return np.asarray((1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * d + u * c))


@dataclass(frozen=True)
class _Printed:
    """A line on a label: text, typeface (the last one is no Hershey face), height of capitals and middle, meters."""

    text: str
    face: int
    capitals: float
    middle: float


def labelled_room(seed: int) -> tuple[Room, list[Line]]:
    """Boxes that stand and books that lie on a table before a wall, each with one to three lines of one to three words.

    Args:
        seed: of everything.
    """
    rng = np.random.default_rng([seed, 30])
    words = [word for word in negative_nouns() if word.isascii() and 3 <= len(word) <= 12]
    room, ground = Room(window=(float(rng.uniform(-0.9, 0.9)), -0.55, 0.85)), Ground(rng, (-0.65, -0.35), (0.65, 0.33))
    top = mottled(("#b98d58", "#d0a870", "#a87c4a"), 14, 1.2, stretch=(0.15, 1, 1))
    room.put("dining table", box((1.3, 0.7, 0.035), top, (0, 0, -0.0175)), "horizontal surface")
    room.put(
        "wall", [sheet([(-0.65, 0.36, 0), (0.65, 0.36, 0), (0.65, 0.36, 0.6), (-0.65, 0.36, 0.6)], plain("#dcd6ca"))]
    )
    lines: list[Line] = []
    for number in range(12):
        lying = number % 2 == 1
        wide, high = float(rng.uniform(0.16, 0.24)), float(rng.uniform(0.13, 0.2))
        deep = float(rng.uniform(0.02, 0.045) if lying else rng.uniform(0.05, 0.09))
        label = _label(rng, words, wide, high)
        built, place = _object(rng, label, wide, high, deep, lying=lying)
        meshes = ground.place(built, turns=0.45)
        if meshes is None:
            continue
        obj = room.put("book" if lying else "box", meshes)
        lines += [Line(obj, line.text, _corners(line, meshes[place].points, wide, high)) for line in label]
    return photographed(room, rng, (0, 0, 0.06), 1.05), lines


def surface_points(room: Room, spacing: float) -> tuple[F64, NDArray[np.int64]]:
    """float64 [K, 3], int64 [K]: points on all objects but floor and wall, one for each square of `spacing` meters, and
    their objects."""
    rng = np.random.default_rng(0)
    points, owners = [], []
    for number, obj in enumerate(room.objects, start=1):
        for mesh in obj.meshes if obj.surface not in ("floor", "wall") else ():
            a, b, c = (mesh.points[mesh.triangles[:, corner]] for corner in range(3))
            areas = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
            rows = np.repeat(np.arange(len(areas)), np.ceil(areas / spacing**2).astype(int))
            u, v = np.sort(rng.uniform(size=(2, len(rows), 1)), axis=0)
            points.append(u * a[rows] + (v - u) * b[rows] + (1 - v) * c[rows])
            owners.append(np.full(len(rows), number))
    return np.concatenate(points), np.concatenate(owners)


def true_objects(room: Room, spacing: float) -> tuple[Gaussians, Objects]:
    """The objects of a room as if each had been found whole: small Gaussians on all that `surface_points` are on."""
    points, owners = surface_points(room, spacing)
    count = len(points)
    gaussians = Gaussians(
        means=points.astype(np.float32),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
        log_scales=np.full((count, 3), np.log(spacing / 2), np.float32),
        logit_opacities=np.full(count, 4.0, np.float32),
        sh=np.zeros((count, 1, 3), np.float32),
        codes=np.zeros((count, 0), np.float32),
    )
    evidence = evidence_of(np.arange(count), owners, np.full(count, 16 * UNIT, np.int64), count)
    table = tuple(Object(number, surface=obj.surface) for number, obj in enumerate(room.objects, start=1))
    return gaussians, Objects(table, evidence)


def _object(
    rng: Random, label: Sequence[_Printed], wide: float, high: float, deep: float, *, lying: bool
) -> tuple[Meshes, int]:
    """A box with a label over its front, which is its top if it lies; and which of its meshes the label is."""
    ground, ink = _GROUNDS[int(rng.integers(len(_GROUNDS)))]
    w, h, front = wide / 2, high / 2, -deep / 2 - 0.0005
    corners = [(-w, front, -h), (w, front, -h), (w, front, h), (-w, front, h)]
    body = box((wide, deep, high), plain(ground, 0.05, 30))
    meshes = placed(
        [*body, sheet(corners, painted(_paint, tuple(label), wide, high, ground, ink))], tip=-np.pi / 2 * lying
    )
    return placed(meshes, z=-float(extent(meshes)[0][2])), len(body)


def _label(rng: Random, words: Sequence[str], wide: float, high: float) -> list[_Printed]:
    """Lines that fit on a label, from the top on."""
    lines, top = [], _MARGIN
    for _ in range(int(rng.integers(1, 4))):
        text = " ".join(rng.choice(words, int(rng.integers(1, 4))).tolist())
        text = (text, text.title(), text.upper())[int(rng.integers(3))]
        face, capitals = int(rng.integers(len(_FACES) + 1)), float(rng.uniform(*_CAPITALS))
        capitals *= min(1.0, (wide - 2 * _MARGIN) / _breadth(text, face, capitals))
        if capitals >= _CAPITALS[0] / 2 and top + 2 * capitals <= high:
            lines.append(_Printed(text, face, capitals, top + capitals))
            top += 2.2 * capitals
    return lines


def _breadth(text: str, face: int, capitals: float) -> float:
    return float(_drawn(text, face, round(capitals * DOTS)).shape[1] / DOTS)


def _drawn(text: str, face: int, capitals: int) -> F32:
    """float32 [3 * capitals, W], 0..1: ink of a line whose capitals are so many pixels high, in the middle."""
    if face == len(_FACES):
        font = ImageFont.load_default(capitals)
        _, top, _, bottom = font.getbbox("H")
        font = ImageFont.load_default(capitals * capitals / (bottom - top))
        left, _, right, _ = font.getbbox(text)
        page = Image.new("L", (int(right - left) + 4, 3 * capitals))
        ImageDraw.Draw(page).text((2 - left, 2 * capitals), text, font=font, fill=255, anchor="ls")
        return np.asarray(np.asarray(page) / 255, np.float32)
    kind, thick = _FACES[face], max(1, round(capitals / 9))
    scale = cv2.getFontScaleFromHeight(kind, capitals, thick)
    (wide, _), _ = cv2.getTextSize(text, kind, scale, thick)
    ink = np.zeros((3 * capitals, wide + 2 * thick), np.uint8)
    cv2.putText(ink, text, (thick, 2 * capitals), kind, scale, 255, thick, cv2.LINE_AA)
    return np.asarray(ink / 255, np.float32)


def _paint(label: Sequence[_Printed], wide: float, high: float, ground: str, ink: str) -> F32:
    """float32 [H, W, 3], sRGB."""
    picture = np.empty((round(high * DOTS), round(wide * DOTS), 3), np.float32)
    picture[:] = hex_rgb(ground)
    for line in label:
        drawn = _drawn(line.text, line.face, round(line.capitals * DOTS))[..., None]
        top, left = round(line.middle * DOTS) - len(drawn) // 2, (picture.shape[1] - drawn.shape[1]) // 2
        rows = slice(max(0, top), top + len(drawn))
        part = picture[rows, left : left + drawn.shape[1]]
        drawn = drawn[max(0, -top) :][: len(part)]
        part[:] = (1 - drawn) * part + drawn * hex_rgb(ink)
    return picture


def _corners(line: _Printed, label: F64, wide: float, high: float) -> F64:
    """Of a line on a label whose corners are at [4, 3]: bottom left and right, top left and right."""
    half = _breadth(line.text, line.face, line.capitals) / 2
    ends = [(x, y) for x, y in ((-half, -0.5), (half, -0.5), (half, 0.5), (-half, 0.5))]
    right, down = (label[1] - label[0]) / wide, (label[0] - label[2]) / high
    middle = (label[2] + label[3]) / 2 + line.middle * down
    return np.array([middle + x * right + y * line.capitals * down for x, y in ends])


def _projected(posed: PosedCamera, points: F64) -> tuple[F64, F64]:
    """Pixels float64 [K, 2], the center of the first one at 0.5, and depths [K]."""
    camera_points = points @ posed.camera_from_world()[:3, :3].T + posed.camera_from_world()[:3, 3]
    camera, depth = posed.camera, camera_points[:, 2]
    return np.stack(
        [camera.fx * camera_points[:, 0] / depth + camera.cx, camera.fy * camera_points[:, 1] / depth + camera.cy], 1
    ), depth
