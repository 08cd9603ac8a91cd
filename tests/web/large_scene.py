"""How the page copes with a scene of a million Gaussians: loading time, the longest time it does not answer, frames.

    python -m tests.web.large_scene --gaussians 1000000 --json figures.json

Draws in Debian's Chromium with software WebGL; what it measures holds for this machine, as busy as it was.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from playwright.sync_api import expect

from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.perception.text.open_text_encoder import open_text_encoder
from fastsplat.service.scene.types import SH_C0, Scene
from fastsplat.service.settings import Settings
from fastsplat_contract.camera import Camera, PosedCamera
from fastsplat_contract.exports import ExportRequest
from tests.api.made_scene import ENCODER, LABELS
from tests.api.served import serving
from tests.scenes import labelled_scene, store_scene
from tests.web.browser import chromium, visiting
from tests.web.places import page_settings
from tests.web.table import looking

_PATIENCE_S = 900.0
_FRAMES_S = 12.0

_LISTEN = """
window.longest = 0;
new PerformanceObserver((list) => {
  for (const entry of list.getEntries()) window.longest = Math.max(window.longest, entry.duration);
}).observe({ type: "longtask", buffered: true });
"""
_ORBIT = """
async (seconds) => {
  const canvas = document.querySelector("canvas[role=application]");
  const begin = performance.now();
  const pauses = [];
  let last = begin;
  while (last - begin < seconds * 1000) {
    const key = { key: "ArrowLeft", bubbles: true };
    canvas.dispatchEvent(new KeyboardEvent("keydown", key));
    await new Promise(requestAnimationFrame);
    const now = performance.now();
    pauses.push(now - last);
    last = now;
  }
  pauses.sort((a, b) => a - b);
  return {
    frames_per_s: (1000 * pauses.length) / (last - begin),
    median_frame_ms: pauses[pauses.length >> 1],
    worst_frame_ms: pauses[pauses.length - 1],
    pixels: [canvas.width, canvas.height],
  };
}
"""


def large_scene(settings: Settings, count: int, degree: int = 3) -> Scene:
    """A room of `count` Gaussians: a floor, and balls on it, three of them with names; harmonics of `degree`."""
    rng = np.random.default_rng(5)
    balls = np.column_stack([rng.uniform(-4, 4, (40, 2)), np.full(40, 0.45)])
    floor = count // 3
    which = rng.integers(len(balls), size=count - floor)
    directions = rng.normal(size=(count - floor, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    means = np.concatenate([
        np.column_stack([rng.uniform(-5, 5, (floor, 2)), rng.normal(scale=0.01, size=floor)]),
        balls[which] + 0.45 * directions,
    ])  # fmt: skip
    colors = np.concatenate([np.full((floor, 3), 0.6), rng.uniform(0.1, 0.9, (len(balls), 3))[which]])
    sh = rng.normal(scale=0.05, size=(count, (degree + 1) ** 2, 3)).astype(np.float32)
    sh[:, 0] = (colors - 0.5) / SH_C0
    ids = np.concatenate([np.zeros(floor, np.int64), np.where(which < len(LABELS), which + 1, 0)])
    camera = Camera(640, 480, 600.0, 600.0, 320.0, 240.0)
    cameras = []
    for number, angle in enumerate(np.linspace(0, 2 * np.pi, 24, endpoint=False)):
        posed = looking(np.array([7 * np.cos(angle), 7 * np.sin(angle), 3.0]), np.array([0, 0, 0.3]), camera)
        cameras.append(PosedCamera(posed.camera, posed.world_from_camera, f"{number:03}.jpg"))
    return labelled_scene(
        means,
        ids,
        LABELS,
        scales=float(1.0 / np.sqrt(count / 100)),
        logit_opacities=3.0,
        sh=sh,
        undetected_bias=2.0,
        encoder=open_text_encoder(ENCODER, settings.models),
        cameras=cameras,
    )


def add_large_scene(service: SceneService, settings: Settings, count: int, degree: int = 3) -> str:
    """Stores the scene as a job that succeeded; returns its id."""
    return store_scene(service._store, large_scene(settings, count, degree), "large")


def measured(url: str, scene_id: str, size: tuple[int, int]) -> dict[str, Any]:
    """What one visit to a scene costs."""
    with chromium() as browser:
        viewport = {"width": size[0], "height": size[1]}
        with visiting(browser, url, viewport=viewport, reduced_motion="no-preference", device_scale_factor=1) as visit:
            visit.page.add_init_script(_LISTEN)
            visit.page.set_default_timeout(_PATIENCE_S * 1000)
            begin = time.monotonic()
            visit.page.goto(f"{url}/#/scenes/{scene_id}")
            visit.page.reload()
            canvas = visit.page.locator("canvas[role=application]")
            expect(canvas).to_have_attribute("data-shown", re.compile("plain$"), timeout=_PATIENCE_S * 1000)
            loaded = time.monotonic() - begin
            # The picture is there once a frame has been drawn after it.
            visit.page.evaluate("async () => { await new Promise(requestAnimationFrame); }")
            first = time.monotonic() - begin
            longest = visit.page.evaluate("window.longest")
            memory = visit.page.evaluate("performance.memory?.usedJSHeapSize ?? 0")
            orbit = visit.page.evaluate(_ORBIT, _FRAMES_S)
    return {
        "loaded_s": loaded,
        "first_picture_s": first,
        "longest_unresponsive_ms": longest,
        "heap_mb": memory / 1e6,
        "orbit": orbit,
    }


def main() -> None:
    """Measure, and print or write the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--gaussians", type=int, default=1_000_000)
    parser.add_argument("--degree", type=int, default=3)
    parser.add_argument("--width", type=int, default=1280)
    parser.add_argument("--height", type=int, default=800)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        settings = page_settings(Path(folder))
        with open_service(settings) as service, serving(service, settings) as ports:
            scene_id = add_large_scene(service, settings, options.gaussians, options.degree)
            file_bytes = len(service.exports.file(ExportRequest(scene_id, "spz")))
            url = f"http://127.0.0.1:{ports.http}"
            figures = measured(url, scene_id, (options.width, options.height))
    figures |= {"gaussians": options.gaussians, "spz_mb": file_bytes / 1e6, "load_average": os.getloadavg()}
    text = json.dumps(figures, indent=1)
    print(text)
    if options.json:
        options.json.write_text(text)


if __name__ == "__main__":
    main()
