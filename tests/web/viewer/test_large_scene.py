"""Where a picture takes long, it is drawn coarsely while the camera moves, and as sharp as before at rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from playwright.sync_api import Browser, expect

from fastsplat.service.scene.artefact.scene import Gaussians
from tests.scenes import store_scene
from tests.web.browser import drawn_canvas, visiting
from tests.web.glow import pixels_of
from tests.web.places import Place
from tests.web.table import table

_SLOW = """
const begun = new WeakMap();
const fence = WebGL2RenderingContext.prototype.fenceSync;
const wait = WebGL2RenderingContext.prototype.clientWaitSync;
WebGL2RenderingContext.prototype.fenceSync = function (...all) {
  const sync = fence.apply(this, all);
  if (sync) begun.set(sync, performance.now());
  window.begun ??= performance.now();
  return sync;
};
WebGL2RenderingContext.prototype.clientWaitSync = function (sync, ...all) {
  if (performance.now() - (begun.get(sync) ?? 0) < 400) return this.TIMEOUT_EXPIRED;
  return wait.call(this, sync, ...all);
};
"""
"""A graphics card that takes 400 ms for a picture."""
_PRESSED = """
(canvas, [key, times]) => {
  for (let time = 0; time < times; time++) canvas.dispatchEvent(new KeyboardEvent("keydown", { key }));
  return canvas.width;
}
"""
_TIMES = 5  # 23 degrees: a color that depends on the viewpoint is another one there


@pytest.mark.parametrize("gaussians", [2_000, 20_000])
def test_a_slow_machine_draws_coarsely_while_the_camera_moves_and_as_before_at_rest(
    place: Place, webgl_browser: Browser, gaussians: int
) -> None:
    """Half the resolution; of a large scene a draft in it."""
    scene, rng = table(place.settings), np.random.default_rng(5)
    rows = rng.integers(len(scene.gaussians), size=gaussians)
    arrays = {name: array[rows] for name, array in vars(scene.gaussians).items()}
    by_viewpoint = rng.normal(scale=0.05, size=(gaussians, 3, 3)).astype(np.float32)
    arrays["sh"] = np.concatenate([arrays["sh"], by_viewpoint], axis=1)
    scene_id = store_scene(place.service._store, replace(scene, gaussians=Gaussians(**arrays)), "large")
    with visiting(webgl_browser, place.url, device_scale_factor=1) as visit:
        visit.page.add_init_script(_SLOW)
        visit.page.goto(f"{place.url}/#/scenes/{scene_id}")
        visit.page.reload()
        canvas = visit.scene_shown()
        box = canvas.bounding_box()
        full = round(box["width"])
        expect(canvas).to_have_attribute("width", str(full))
        visit.page.wait_for_function("() => performance.now() - window.begun > 200")  # its first picture takes long
        before = pixels_of(drawn_canvas(visit.page))
        moving = canvas.evaluate(_PRESSED, ["ArrowLeft", _TIMES])
        # A draft has been drawn before, took long, and is smaller still.
        assert moving == (full + 1) // 2 if gaussians < 18_000 else full / 5 < moving <= (full + 1) // 2
        expect(canvas).to_have_attribute("width", str(full))
        elsewhere = pixels_of(drawn_canvas(visit.page))
        assert np.abs(elsewhere - before).mean() > 1
        assert canvas.evaluate(_PRESSED, ["Home", 1]) < full
        expect(canvas).to_have_attribute("width", str(full))
        assert np.abs(pixels_of(drawn_canvas(visit.page)) - before).max() <= 1
        assert any("splatWorker" in url for url in visit.requests)
