"""Small mesh and material vocabulary over Blender's `bpy` for the sample scene. Meters, z up, sRGB hex colours."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import bpy
import numpy as np
from numpy.typing import ArrayLike, NDArray

from demo.sample_paint import hex_rgb

Points = NDArray[np.float64]
Parts = list[Any]


def spline(control: ArrayLike, count: int) -> Points:
    """Catmull-Rom curve through control points [K, D], sampled evenly in its parameter: [count, D]."""
    p = np.asarray(control, float)
    p = np.concatenate([2 * p[:1] - p[1:2], p, 2 * p[-1:] - p[-2:-1]])
    t = np.linspace(0, len(p) - 3 - 1e-9, count)
    i, s = t.astype(int), (t % 1)[:, None]
    a, b, c, d = p[i], p[i + 1], p[i + 2], p[i + 3]
    return np.asarray(0.5 * (2 * b + (c - a) * s + (2 * a - 5 * b + 4 * c - d) * s**2 + (3 * b - a - 3 * c + d) * s**3))


def grid(name: str, points: ArrayLike, material: Any, wrap: bool = False, close: bool = False) -> Any:
    """A smooth surface through points [A, B, 3], UV = (b, a); `wrap` joins the ends of B, `close` those of A."""
    p = np.asarray(points, float)
    na, nb = p.shape[:2]
    lattice = np.meshgrid(np.arange(na - (not close)), np.arange(nb - (not wrap)), indexing="ij")
    a, b = (axis.ravel() for axis in lattice)
    corners = [(a, b), (a, b + 1), (a + 1, b + 1), (a + 1, b)]
    faces = np.stack([(i % na) * nb + j % nb for i, j in corners], axis=1)
    sides_a, sides_b = max(na - (not close), 1), max(nb - (not wrap), 1)
    uvs = np.stack([np.stack([j / sides_b, i / sides_a], axis=1) for i, j in corners], axis=1).reshape(-1, 2)
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(p.reshape(-1, 3).tolist(), [], faces.tolist())
    mesh.uv_layers.new(name="UVMap").data.foreach_set("uv", uvs.ravel().astype(np.float32))
    mesh.shade_smooth()
    return _link(name, mesh, material)


def lathe(name: str, profile: ArrayLike, material: Any, sides: int = 72, count: int = 0) -> Any:
    """A surface of revolution about z from a profile [K, 2] of (radius, height), splined if `count` is given."""
    outline = spline(profile, count) if count else np.asarray(profile, float)
    angle = np.linspace(0, 2 * np.pi, sides, endpoint=False)
    r, z = np.maximum(outline[:, :1], 1e-5), outline[:, 1:]
    return grid(name, np.stack([r * np.cos(angle), r * np.sin(angle), z + 0 * angle], axis=-1), material, wrap=True)


def ball(
    name: str, radii: Sequence[float], material: Any, centre: Sequence[float] = (0, 0, 0), turn: ArrayLike = ()
) -> Any:
    """An ellipsoid with the given half axes; `turn` holds Euler angles in radians."""
    theta, phi = np.linspace(1e-4, np.pi - 1e-4, 32), np.linspace(0, 2 * np.pi, 48, endpoint=False)
    s = np.sin(theta)[:, None]
    unit = np.stack([s * np.cos(phi), s * np.sin(phi), np.cos(theta)[:, None] + 0 * phi], axis=-1)
    obj = grid(name, (unit * np.asarray(radii, float))[::-1], material, wrap=True)
    obj.location = centre
    obj.rotation_euler = tuple(np.asarray(turn, float)) if np.size(turn) else (0, 0, 0)
    return obj


def tube(name: str, path: ArrayLike, radius: ArrayLike, material: Any, sides: int = 24, squash: float = 1.0) -> Any:
    """A round tube along a path [K, 3] with radius scalar or [K]; `squash` flattens it across."""
    p = np.asarray(path, float)
    r = np.broadcast_to(np.asarray(radius, float), len(p))
    tangent = np.gradient(p, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    side = np.cross(tangent[0], (0.31, 0.2, 0.93) if abs(tangent[0][2]) < 0.9 else (0.0, 1.0, 0.0))
    rings = []
    for k in range(len(p)):  # parallel transport: the ring never twists
        side = side - tangent[k] * (side @ tangent[k])
        side /= np.linalg.norm(side)
        binormal = np.cross(tangent[k], side)
        angle = np.linspace(0, 2 * np.pi, sides, endpoint=False)[:, None]
        rings.append(p[k] + r[k] * (np.cos(angle) * side + squash * np.sin(angle) * binormal))
    rings = [np.repeat(p[:1], sides, 0) + 1e-4 * (rings[0] - p[0]), *rings, p[-1] + 1e-4 * (rings[-1] - p[-1])]
    return grid(name, np.stack(rings), material, wrap=True)


def box(
    name: str, size: Sequence[float], material: Any, centre: Sequence[float] = (0, 0, 0), bevel: float = 0.002
) -> Any:
    """A box of the given size with rounded edges."""
    x, y, z = (
        np.array([[-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1], [-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]])
        * 0.5
    ).T
    mesh = bpy.data.meshes.new(name)
    sides = [(0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]
    mesh.from_pydata(np.stack([x * size[0], y * size[1], z * size[2]], axis=1).tolist(), [], sides)
    obj = _link(name, mesh, material)
    obj.location = centre
    if bevel:
        rounding = obj.modifiers.new("bevel", "BEVEL")
        rounding.width, rounding.segments = bevel, 3
    return obj


def picture(name: str, corners: ArrayLike, image: NDArray[np.float32], rough: float = 0.6) -> Any:
    """A flat picture; corners [4, 3] = bottom left, bottom right, top right, top left."""
    c = np.asarray(corners, float)
    return grid(name, np.stack([np.stack([c[0], c[1]]), np.stack([c[3], c[2]])]), painted(name, image, rough))


def writing(text: str, size: float, centre: Sequence[float], turn: Sequence[float], material: Any) -> Any:
    """A line of raised letters in Blender's own font."""
    curve = bpy.data.curves.new(text, "FONT")
    curve.body, curve.size, curve.extrude = text, size, 0.0003
    curve.align_x, curve.align_y = "CENTER", "CENTER"
    obj = _link(text, curve, material)
    obj.location, obj.rotation_euler = centre, turn
    return obj


def plain(name: str, colour: str, rough: float = 0.5, **inputs: float) -> Any:
    """One colour; further Principled inputs by name, spaces as underscores (coat_weight=0.3)."""
    material, shader = _material(name, rough, inputs)
    shader.inputs["Base Color"].default_value = _linear(colour)
    return material


def mottled(
    name: str, colours: Sequence[str], scale: float, rough: float = 0.5, bump: float = 0.0,
    stretch: Sequence[float] = (1, 1, 1), contrast: float = 1.0, **inputs: float,
) -> Any:  # fmt: skip
    """Colours mixed by three-dimensional multi-octave noise (it never repeats); `scale` = features a meter."""
    material, shader = _material(name, rough, inputs)
    nodes, links = material.node_tree.nodes, material.node_tree.links
    place, mapping = nodes.new("ShaderNodeTexCoord"), nodes.new("ShaderNodeMapping")
    mapping.inputs["Scale"].default_value = stretch
    links.new(place.outputs["Object"], mapping.inputs["Vector"])
    field = nodes.new("ShaderNodeTexNoise")
    field.inputs["Scale"].default_value, field.inputs["Detail"].default_value = scale, 9.0
    field.inputs["Roughness"].default_value, field.inputs["Distortion"].default_value = 0.6, 0.4
    links.new(mapping.outputs["Vector"], field.inputs["Vector"])
    colour = nodes.new("ShaderNodeValToRGB")
    half = 0.28 / contrast
    for k, (at, value) in enumerate(zip(np.linspace(0.5 - half, 0.5 + half, len(colours)), colours, strict=True)):
        stop = colour.color_ramp.elements[k] if k < 2 else colour.color_ramp.elements.new(float(at))
        stop.position, stop.color = float(at), _linear(value)
    links.new(field.outputs[0], colour.inputs[0])
    links.new(colour.outputs["Color"], shader.inputs["Base Color"])
    if bump:
        relief = nodes.new("ShaderNodeBump")
        relief.inputs["Distance"].default_value, relief.inputs["Strength"].default_value = bump, 0.6
        links.new(field.outputs[0], relief.inputs["Height"])
        links.new(relief.outputs["Normal"], shader.inputs["Normal"])
    return material


def painted(name: str, image: NDArray[np.float32], rough: float = 0.6, **inputs: float) -> Any:
    """A picture [H, W, 3] (row 0 on top) laid once over the UV square."""
    material, shader = _material(name, rough, inputs)
    h, w = image.shape[:2]
    stored = bpy.data.images.new(name, w, h)
    stored.pixels.foreach_set(np.concatenate([image[::-1], np.ones((h, w, 1), np.float32)], axis=2).ravel())
    stored.pack()
    node = material.node_tree.nodes.new("ShaderNodeTexImage")
    node.image, node.extension = stored, "EXTEND"
    material.node_tree.links.new(node.outputs["Color"], shader.inputs["Base Color"])
    return material


def fur(obj: Any, count: int, length: float, seed: int) -> None:
    """Short plush hair in the object's own material."""
    obj.modifiers.new("fur", "PARTICLE_SYSTEM")
    system = obj.particle_systems[0]
    system.seed = seed
    hair = system.settings
    hair.type, hair.count, hair.hair_length, hair.hair_step = "HAIR", count, length, 3
    hair.brownian_factor, hair.child_type = 0.004, "SIMPLE"
    hair.rendered_child_count, hair.child_radius, hair.roughness_2 = 8, 0.004, 0.008
    hair.root_radius, hair.tip_radius, hair.radius_scale = 0.35, 0.05, 0.001


def place(parts: Parts, x: float, y: float, turn: float, z: float = 0.0, tip: float = 0.0, scale: float = 1.0) -> Parts:
    """Moves parts that belong together; returns them with their common anchor, so that places can be nested."""
    anchor = bpy.data.objects.new("place", None)
    anchor.location, anchor.rotation_euler = (x, y, z), (tip, 0, turn)
    anchor.scale = (scale,) * 3
    bpy.context.scene.collection.objects.link(anchor)
    for part in parts:
        if part.parent is None:
            part.parent = anchor
    return [*parts, anchor]


def _link(name: str, data: Any, material: Any) -> Any:
    obj = bpy.data.objects.new(name, data)
    if material is not None:
        data.materials.append(material)
    bpy.context.scene.collection.objects.link(obj)
    return obj


def _material(name: str, rough: float, inputs: dict[str, float]) -> tuple[Any, Any]:
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    shader = next(n for n in material.node_tree.nodes if n.type == "BSDF_PRINCIPLED")
    shader.inputs["Roughness"].default_value = rough
    for key, value in inputs.items():
        shader.inputs[key.replace("_", " ").title().replace("Ior", "IOR")].default_value = value
    return material, shader


def _linear(colour: str) -> tuple[float, ...]:
    rgb = hex_rgb(colour)
    return (*np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4).tolist(), 1.0)
