"""What benchmarks of objects share: a scene trained without labels, seconds, and a contact sheet."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from PIL import Image

from fastsplat.service.capture.captures import Capture
from fastsplat.service.common.dictionary import Dictionary
from fastsplat.service.jobs.create_scene import build_scene
from fastsplat.service.perception.results import Labelling
from fastsplat.service.query.drawing.pictures import label_colors
from fastsplat.service.query.drawing.scene_renderer import Renderer
from fastsplat.service.scene.artefact.scene import Scene
from fastsplat.service.scene.artefact.scene_files import read_scene, write_scene
from fastsplat.service.settings import Settings, load_settings
from fastsplat.service.splatting.labels.blending import object_map

_SHEET_VIEWS = 4
_PANEL = (480, 360)

T = TypeVar("T")


def settings_by_steps(iterations: int, gaussians: int) -> Settings:
    """The service's settings for a run of so many steps and Gaussians, whatever time it takes, so that figures do not
    depend on how busy the machine is; no view is held out."""
    settings = load_settings()
    bounds = {"iterations": iterations, "max_gaussians": gaussians, "time_budget_s": None, "held_out_every": 0}
    return settings.model_copy(update={"training": settings.training.model_copy(update=bounds)})


def trained_scene(folder: Path, capture: Capture, settings: Settings) -> Scene:
    """The scene that lies in `folder`; it is trained without labels, and written there, if it does not."""
    if not folder.is_dir():
        built = build_scene(replace(capture, given_labels=None), settings, labelling=Labelling(Dictionary(()), ()))
        write_scene(built.scene, folder)
    return read_scene(folder)


def timed(work: Callable[[], T]) -> tuple[T, dict[str, float]]:
    """What `work` returns, with its `seconds` and `cpu_seconds`."""
    wall, cpu = time.perf_counter(), time.process_time()
    result = work()
    seconds = {"seconds": time.perf_counter() - wall, "cpu_seconds": time.process_time() - cpu}
    return result, {key: round(value, 1) for key, value in seconds.items()}


def draw_sheet(scene: Scene, capture: Capture, path: Path, *, scale: float = 1.0, quality: int = 85) -> None:
    """The scene where photos were taken, beside the objects that it shows there, each in a color of its own; panels of
    480×360 pixels times `scale`, as a JPEG. Photos of others are not in it: a sheet is kept with the results."""
    assert scene.objects is not None
    colors = label_colors(max((obj.id for obj in scene.objects.table), default=0))
    size = (round(_PANEL[0] * scale), round(_PANEL[1] * scale))
    renderer, rows = Renderer(scene, load_settings().query), []
    for position in np.linspace(0, len(capture.views) - 1, _SHEET_VIEWS).round().astype(int):
        view = capture.views[position]
        picture = renderer.colors(view.posed)
        ids = object_map(scene, view.posed)
        mixed = (0.4 * picture + 0.6 * colors[ids]).astype(np.uint8)
        panels = [np.asarray(Image.fromarray(panel).resize(size)) for panel in (picture, mixed)]
        rows.append(np.hstack(panels))
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.vstack(rows)).save(path, quality=quality)
