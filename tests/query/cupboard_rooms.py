"""Rooms with something closed in which an object may be, and rooms without; of their surfaces, what the photos show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.query.objects.visibility import SightLines
from fastsplat.service.scene.artefact.scene import Gaussians, Scene
from fastsplat_contract.geometry.camera import PosedCamera
from tests.query.box_scenes import BoxShell, look, scene_of
from tests.query.walled_room import OBJECTS, WALLS

Random = np.random.Generator

_SHUT = ("cupboard", "cabinet", "wardrobe", "carton", "refrigerator", "suitcase", "chest of drawers")
_SOLID = ("couch", "bed", "armchair", "stove top", "teddy bear", "potted plant")
_THICK = 0.06


def with_something_shut(seed: int) -> Scene:
    """A room with a closed object of 0.06 to 1 m³."""
    rng = np.random.default_rng([seed, 0])
    volume = float(np.exp(rng.uniform(np.log(0.06), 0.0)))
    edges = rng.uniform(0.75, 1.35, 3)
    edges *= (volume / edges.prod()) ** (1 / 3)
    return _scene(_room(rng, [_standing(rng, _SHUT[seed % len(_SHUT)], edges)]), _cameras(rng))


def without(seed: int) -> Scene:
    """A room in which nothing as large as a mug is out of sight: hollow objects are open or small."""
    rng = np.random.default_rng([seed, 1])
    large = _standing(rng, _SOLID[seed % len(_SOLID)], rng.uniform(0.4, 0.9, 3))
    small = BoxShell("box", (0.0, -0.1, 0.07), (0.16, 0.14, 0.14))
    shelf = _standing(rng, "cabinet", np.array([0.7, 0.3, 0.6]))
    boxes = [[large], [large, small], _open(shelf)][seed % 3]
    return _scene(_room(rng, boxes), _cameras(rng))


def _room(rng: Random, boxes: Sequence[BoxShell]) -> list[BoxShell]:
    shift = rng.uniform(-0.15, 0.15, 2)
    objects = [
        replace(box, centre=(box.centre[0] + shift[0], box.centre[1] + shift[1], box.centre[2])) for box in OBJECTS
    ]
    return [*WALLS, *objects, *boxes]


def _standing(rng: Random, label: str, edges: NDArray[np.float64]) -> BoxShell:
    """A box on the floor beside the wall at y = 1.5, or in a corner of it."""
    x, y, z = edges.tolist()
    place = (float(rng.uniform(-1.9 + x / 2, 1.9 - x / 2)), 1.45 - y / 2, z / 2)
    return BoxShell(label, place, (x, y, z), count=2500)


def _open(box: BoxShell) -> list[BoxShell]:
    """Its sides, back, top and bottom, without the side to the room."""
    (x, y, z), (width, deep, high) = box.centre, box.size
    walls = [
        ((x, y + deep / 2, z), (width, 0.01, high)),
        ((x - width / 2, y, z), (0.01, deep, high)),
        ((x + width / 2, y, z), (0.01, deep, high)),
        ((x, y, z - high / 2), (width, deep, 0.01)),
        ((x, y, z + high / 2), (width, deep, 0.01)),
    ]
    return [BoxShell(box.label, middle, size, count=700) for middle, size in walls]


def _cameras(rng: Random) -> list[PosedCamera]:
    """Around the middle of the room, or from its side at y = -1.2; all look at its middle."""
    eyes = [(1.6 * np.cos(a), 1.1 * np.sin(a), 1.4) for a in np.arange(20) * np.pi / 10]
    if rng.uniform() < 0.5:
        eyes = [(x, -1.2, z) for x in np.linspace(-1.7, 1.7, 8) for z in (0.5, 1.5)]
    middle = (*rng.uniform(-0.2, 0.2, 2), 0.3)
    return [look(eye, middle, f"{number}.jpg") for number, eye in enumerate(eyes)]


def _scene(boxes: Sequence[BoxShell], cameras: Sequence[PosedCamera]) -> Scene:
    """What photos show of them: a trained scene has no other surfaces."""
    scene = scene_of(boxes, cameras)
    means = scene.gaussians.means.astype(np.float64)
    mask = np.zeros(len(means), np.bool_)
    for posed in cameras:
        sight = SightLines(posed, means)
        cell, depth, ahead = sight.cells(means)
        mask[ahead[depth <= sight.nearest[cell] + _THICK]] = True
    return replace(scene, gaussians=Gaussians(**{name: rows[mask] for name, rows in vars(scene.gaussians).items()}))
