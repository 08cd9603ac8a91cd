"""A room with walls, some objects, and a screen behind which objects could be."""

from __future__ import annotations

from fastsplat_contract.geometry.camera import PosedCamera
from tests.query.box_scenes import BoxShell, look

_WIDE, _DEEP, HEIGHT = 4.0, 3.0, 2.4
WALLS = [
    BoxShell("floor", (0, 0, -0.01), (_WIDE, _DEEP, 0.02), count=6000),
    BoxShell("wall", (-_WIDE / 2, 0, HEIGHT / 2), (0.02, _DEEP, HEIGHT), count=4000),
    BoxShell("wall", (_WIDE / 2, 0, HEIGHT / 2), (0.02, _DEEP, HEIGHT), count=4000),
    BoxShell("wall", (0, -_DEEP / 2, HEIGHT / 2), (_WIDE, 0.02, HEIGHT), count=4000),
    BoxShell("wall", (0, _DEEP / 2, HEIGHT / 2), (_WIDE, 0.02, HEIGHT), count=4000),
]
OBJECTS = [
    BoxShell("mug", (0.3, 0.2, 0.06), (0.12, 0.12, 0.12)),
    BoxShell("book", (-0.4, 0.3, 0.03), (0.25, 0.18, 0.06)),
    BoxShell("lamp", (0.6, -0.5, 0.2), (0.2, 0.2, 0.4)),
]
SCREEN = BoxShell("screen", (-1.0, 0.3, 0.8), (0.05, 2.0, 1.6), count=3500)


def from_corner() -> list[PosedCamera]:
    """A row of cameras at one end of the room, which look at its middle."""
    return [look((1.7 - 0.1 * i, -1.2, 1.5), (0, 0.4, 0.3), f"{i}.jpg") for i in range(8)]
