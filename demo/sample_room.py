"""The sample scene's room: a round table in the corner of two painted walls, soft daylight, and the cameras."""

from __future__ import annotations

from math import cos, pi, radians, sin, sqrt
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix, Vector

from demo.sample_mesh import box, lathe, mottled, picture
from demo.sample_paint import cloth, mural, planks, print_landscape, print_shapes

TABLE_RADIUS = 0.54
TABLE_HEIGHT = 0.74
_WALL_DISTANCE = 0.6  # from the table's axis to each wall, meters
_RINGS = ((21.0, 1.0, 12, 60.0, 0.07), (40.0, 1.0, 9, 54.0, 0.06), (58.0, 0.98, 5, 38.0, 0.05))


def build_room() -> None:
    """Walls, floor, prints and light; all of them without an id."""
    _wall(-1, mural(1400, 2000, 3))
    _wall(1, mural(1400, 2000, 41))
    low = -TABLE_HEIGHT
    picture("floor", [(-2, -2.2, low), (2, -2.2, low), (2, 1.8, low), (-2, 1.8, low)], planks(2000, 2000, 17), 0.5)
    _print(-1, 0.62, 0.40, (0.30, 0.40), print_landscape(512, 384, 71))
    _print(1, 0.45, 0.33, (0.40, 0.30), print_shapes(384, 512, 83))
    _daylight()


def build_table() -> list[Any]:
    """The round table and its printed cloth; the table top is z = 0."""
    wood = mottled("oak", ("#4a2a16", "#6e4526", "#93633a", "#7d5230", "#5a371e"), 12, 0.38, 0.0004, (1, 6, 6), 1.1)
    r = TABLE_RADIUS
    top = lathe(
        "table",
        [
            (0, -0.03),
            (r - 0.02, -0.03),
            (r - 0.004, -0.026),
            (r, -0.018),
            (r, -0.01),
            (r - 0.004, -0.003),
            (r - 0.01, -0.0016),
            (0, -0.0016),
        ],
        wood,
        160,
    )
    foot = lathe(
        "foot", [(0.22, -0.735), (0.2, -0.71), (0.05, -0.66), (0.045, -0.2), (0.08, -0.04), (0.09, -0.03)], wood
    )
    h = 0.36
    sheet = picture(
        "cloth", [(-h, -h, -0.0008), (h, -h, -0.0008), (h, h, -0.0008), (-h, h, -0.0008)], cloth(1600, 1600, 23), 0.85
    )
    for corner in sheet.data.vertices:
        corner.co.xy = (corner.co.x * 1.02, corner.co.y)
    return [top, foot, sheet]


def camera_poses(seed: int = 7) -> list[Any]:
    """World-from-camera matrices (OpenGL axes) on three rings of 12, 9 and 5 views around the table's front."""
    rng = np.random.default_rng(seed)
    poses = []
    for elevation, distance, count, half, height in _RINGS:
        for k, azimuth in enumerate(np.linspace(-half, half, count)):
            a = radians(azimuth + float(rng.uniform(-1.2, 1.2)))
            e = radians(elevation + (2.5 if k % 2 else -2.5) + float(rng.uniform(-1, 1)))
            reach = distance * float(rng.uniform(0.93, 1.05))
            target = Vector((*rng.uniform(-0.025, 0.025, 2), height + float(rng.uniform(-0.015, 0.015))))
            eye = target + reach * Vector((sin(a) * cos(e), -cos(a) * cos(e), sin(e)))
            turn = (target - eye).to_track_quat("-Z", "Y").to_matrix().to_4x4()
            poses.append(Matrix.Translation(eye) @ turn)
    return poses


def _wall(side: int, image: Any) -> None:
    along, corner = Vector((side * sqrt(0.5), -sqrt(0.5), 0)), Vector((0, _WALL_DISTANCE * sqrt(2), 0))
    ends = [corner, corner + 2.0 * along]
    left, right = (ends[1], ends[0]) if side < 0 else (ends[0], ends[1])
    low, high = Vector((0, 0, -TABLE_HEIGHT)), Vector((0, 0, 1.4 - TABLE_HEIGHT))
    picture(f"wall {side}", [left + low, right + low, right + high, left + high], image, 0.9)


def _print(side: int, from_corner: float, height: float, size: tuple[float, float], image: Any) -> None:
    along, corner = Vector((side * sqrt(0.5), -sqrt(0.5), 0)), Vector((0, _WALL_DISTANCE * sqrt(2), 0))
    inward = Vector((-side * sqrt(0.5), -sqrt(0.5), 0))
    right = along if side > 0 else -along
    centre = corner + from_corner * along + Vector((0, 0, height))
    half_w, half_h = right * size[0] / 2, Vector((0, 0, size[1] / 2))
    front = centre + inward * 0.0132
    picture(
        f"print {side}",
        [front - half_w - half_h, front + half_w - half_h, front + half_w + half_h, front - half_w + half_h],
        image,
        0.35,
    )
    frame = box(
        "frame",
        (size[0] + 0.03, 0.026, size[1] + 0.03),
        mottled(f"frame {side}", ("#3a2618", "#5c3d26"), 30, 0.5),
        centre,
        0.003,
    )
    frame.rotation_euler = (0, 0, -side * pi / 4)


def _daylight() -> None:
    scene = bpy.context.scene
    scene.world = bpy.data.worlds.new("sky")
    scene.world.use_nodes = True
    sky = next(n for n in scene.world.node_tree.nodes if n.type == "BACKGROUND")
    sky.inputs["Color"].default_value, sky.inputs["Strength"].default_value = (0.86, 0.93, 1.0, 1.0), 0.55
    for name, spot, size, power, colour in (
        ("window", (1.5, -1.1, 1.5), 1.3, 42.0, (1.0, 0.95, 0.87)),
        ("fill", (-1.4, -1.2, 1.3), 1.6, 9.0, (0.9, 0.95, 1.0)),
    ):
        light = bpy.data.lights.new(name, "AREA")
        light.shape, light.size, light.energy, light.color = "SQUARE", size, power, colour
        lamp = bpy.data.objects.new(name, light)
        lamp.location = spot
        lamp.rotation_euler = (Vector((0, 0.1, 0)) - Vector(spot)).to_track_quat("-Z", "Y").to_euler()
        lamp.visible_camera = False
        scene.collection.objects.link(lamp)
