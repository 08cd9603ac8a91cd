"""A scene of many Gaussians: read in a worker, drawn coarsely while the camera moves where a picture takes long."""

from __future__ import annotations

import re

import pytest
from playwright.sync_api import Browser, expect

from tests.web.browser import visiting
from tests.web.large_scene import add_large_scene
from tests.web.places import Place

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
() => {
  const canvas = document.querySelector("canvas[role=application]");
  canvas.dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowLeft", bubbles: true }));
  return canvas.width;
}
"""


@pytest.mark.parametrize("gaussians", [2_000, 130_000])
def test_a_slow_machine_draws_coarsely_while_the_camera_moves_and_all_at_rest(
    place: Place, webgl_browser: Browser, gaussians: int
) -> None:
    """Half the resolution; of a large scene a draft in it."""
    scene_id = add_large_scene(place.service, place.settings, gaussians, degree=1)
    with visiting(webgl_browser, place.url, device_scale_factor=1) as visit:
        visit.page.add_init_script(_SLOW)
        visit.page.goto(f"{place.url}/#/scenes/{scene_id}")
        visit.page.reload()
        canvas = visit.page.locator("canvas[role=application]")
        expect(canvas).to_have_attribute("data-shown", re.compile("plain$"), timeout=120_000)
        box = canvas.bounding_box()
        assert box is not None
        full = round(box["width"])
        expect(canvas).to_have_attribute("width", str(full))
        visit.page.wait_for_function("() => performance.now() - window.begun > 200")  # its first picture takes long
        assert visit.page.evaluate(_PRESSED) == (full + 1) // 2
        expect(canvas).to_have_attribute("width", str(full))
        assert any("splatWorker" in url for url in visit.requests)
