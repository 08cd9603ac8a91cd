"""Renders the sample capture in `demo/sample/`: pictures, exact id masks, labels and poses of a small table scene.

    python3.11 -m venv blender-venv && blender-venv/bin/pip install bpy==5.0.1 numpy
    blender-venv/bin/python -m demo.render_sample

Everything is modelled and painted by the modules beside this one, from fixed seeds; nothing is downloaded. Pictures are
path traced by Cycles on the CPU and denoised; masks come from a second render with one ray through each pixel's centre
and the object's id as its colour, so that they are exact; a third one has an id for each single object, where a mask
has one for all objects of a label. Poses are nerfstudio's `transforms.json`.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import bpy

from demo.sample_layout import OBJECTS
from demo.sample_mesh import Parts
from demo.sample_room import build_room, build_table, camera_poses

WIDTH, HEIGHT = 480, 360
_FIELD_OF_VIEW = math.radians(60.0)  # horizontal
_TABLE_LABEL = "dining table"


def main() -> None:
    """Builds the scene and writes the capture; `--views` and `--samples` are for quick looks."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path(__file__).resolve().parent / "sample")
    parser.add_argument("--samples", type=int, default=24)
    parser.add_argument("--views", type=int, nargs="*", help="only these view numbers")
    parser.add_argument("--ids-only", action="store_true", help="masks and instances, no pictures")
    args = parser.parse_args()

    bpy.ops.wm.read_factory_settings(use_empty=True)
    labels, copies = _build()
    poses = camera_poses()
    numbers = range(len(poses)) if args.views is None else args.views
    (args.out / "images").mkdir(parents=True, exist_ok=True)
    (args.out / "masks").mkdir(exist_ok=True)
    (args.out / "instances").mkdir(exist_ok=True)
    camera = _camera()
    frames = []
    for k in numbers:
        camera.matrix_world = poses[k]
        bpy.context.view_layer.update()
        begin = time.monotonic()
        if not args.ids_only:
            _render_picture(args.out / f"images/{k:03d}.jpg", args.samples)
        _number(copies, [labels[label] for label, _ in copies])
        _render_ids(args.out / f"masks/{k:03d}.png")
        _number(copies, range(1, len(copies) + 1))
        _render_ids(args.out / f"instances/{k:03d}.png")
        print(f"view {k}: {time.monotonic() - begin:.1f} s", flush=True)
        matrix = [[round(float(v), 9) for v in row] for row in camera.matrix_world]
        paths = {"file_path": f"images/{k:03d}.jpg", "mask_path": f"masks/{k:03d}.png"}
        frames.append({**paths, "instance_path": f"instances/{k:03d}.png", "transform_matrix": matrix})
    focal = WIDTH / (2 * math.tan(_FIELD_OF_VIEW / 2))
    intrinsics = {"fl_x": focal, "fl_y": focal, "cx": WIDTH / 2, "cy": HEIGHT / 2, "w": WIDTH, "h": HEIGHT}
    content = {
        "camera_model": "PINHOLE",
        **intrinsics,
        "labels": labels,
        "instances": [label for label, _ in copies],
        "frames": frames,
    }
    (args.out / "transforms.json").write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def _build() -> tuple[dict[str, int], list[tuple[str, Parts]]]:
    """Ids of the labels, and of every object its label and parts."""
    build_room()
    copies = [(label, build()) for label, builders in OBJECTS.items() for build in builders]
    copies.append((_TABLE_LABEL, build_table()))
    labels = dict.fromkeys(label for label, _ in copies)
    return {label: number for number, label in enumerate(labels, start=1)}, copies


def _number(copies: Sequence[tuple[str, Parts]], ids: Iterable[int]) -> None:
    for (_, parts), number in zip(copies, ids, strict=True):
        for part in parts:
            part.pass_index = number


def _camera() -> Any:
    scene = bpy.context.scene
    lens = bpy.data.cameras.new("camera")
    lens.sensor_fit, lens.angle, lens.clip_start = "HORIZONTAL", _FIELD_OF_VIEW, 0.02
    camera = bpy.data.objects.new("camera", lens)
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.render.engine = "CYCLES"
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = WIDTH, HEIGHT, 100
    scene.cycles.device, scene.cycles.seed = "CPU", 1
    scene.cycles.max_bounces, scene.cycles.sample_clamp_indirect = 4, 4.0
    scene.cycles.adaptive_threshold = 0.02
    scene.render.use_persistent_data = True
    scene.cycles.denoiser = "OPENIMAGEDENOISE"
    return camera


def _render_picture(path: Path, samples: int) -> None:
    scene = bpy.context.scene
    scene.view_layers[0].material_override = None
    scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.use_adaptive_sampling = samples, True, True
    scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BLACKMAN_HARRIS", 1.5
    scene.view_settings.view_transform, scene.view_settings.look = "Khronos PBR Neutral", "None"
    scene.view_settings.exposure = 0.1
    scene.render.dither_intensity = 0.0
    settings = scene.render.image_settings
    settings.file_format, settings.quality, settings.color_mode = "JPEG", 92, "RGB"
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)


def _render_ids(path: Path) -> None:
    """Ids as grey values: one unfiltered ray a pixel, every surface glows with its object's number."""
    scene = bpy.context.scene
    scene.view_layers[0].material_override = _id_material()
    world, scene.world = scene.world, None
    hidden = [light for light in scene.objects if light.type == "LIGHT"]
    for light in hidden:
        light.hide_render = True
    scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.use_adaptive_sampling = 1, False, False
    scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BOX", 0.01
    scene.view_settings.view_transform, scene.view_settings.look, scene.view_settings.exposure = "Raw", "None", 0.0
    settings = scene.render.image_settings
    scene.render.dither_intensity = 0.0
    settings.file_format, settings.color_mode, settings.color_depth = "PNG", "BW", "8"
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    scene.world = world
    for light in hidden:
        light.hide_render = False


def _id_material() -> Any:
    stored = bpy.data.materials.get("ids")
    if stored is not None:
        return stored
    material = bpy.data.materials.new("ids")
    material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    nodes.clear()
    info, glow, out = (nodes.new(f"ShaderNode{kind}") for kind in ("ObjectInfo", "Emission", "OutputMaterial"))
    share = nodes.new("ShaderNodeMath")
    share.operation = "DIVIDE"
    share.inputs[1].default_value = 255.0
    links.new(info.outputs["Object Index"], share.inputs[0])
    links.new(share.outputs[0], glow.inputs["Strength"])
    glow.inputs["Color"].default_value = (1, 1, 1, 1)
    links.new(glow.outputs["Emission"], out.inputs["Surface"])
    return material


if __name__ == "__main__":
    main()
