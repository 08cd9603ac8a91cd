"""One visit to a scene's page in Chromium: what it loads, how long that takes, and how many frames it draws."""

from __future__ import annotations

import json
import shutil
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from playwright.sync_api import Browser, Page, Playwright, Request, ViewportSize

_PROBE = (Path(__file__).parent / "probe.js").read_text()
_WEBGL = ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox")
_NO_WEBGL = ("--disable-3d-apis", "--disable-gpu", "--no-sandbox")
_SIDES: ViewportSize = {"width": 1000, "height": 569}  # of the window, so that the 3D view has 640 x 480 pixels
_PATIENCE_MS = 300_000
_ORBIT = """async (seconds) => {
  const canvas = document.querySelector("canvas");
  const [begin, before] = [performance.now(), window.probe.frames];
  while (performance.now() - begin < 1000 * seconds) {
    canvas.dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowLeft" }));
    await new Promise(requestAnimationFrame);
  }
  return (1000 * (window.probe.frames - before)) / (performance.now() - begin);
}"""


@dataclass(frozen=True)
class Visited:
    """What one visit measured.

    Attributes:
        view: width and height of the 3D view, pixels.
        renderer: of WebGL; "" without.
        first_paint_s, interactive_s, scene_shown_s: since the navigation began: something is painted; a question can be
            typed; the scene is shown, as a picture of the server.
        ready_s: from a first gesture until the browser draws the scene; without WebGL, until the page knows what photos
            saw of it.
        bytes: transferred with their headers until then, by kind.
        frames_per_s: while orbiting after that.
        enter_to_glow_s: from the key to the first frame in which the answer glows.
        server_pictures: sizes of the pictures that the server drew, and how many of each.
    """

    view: tuple[int, int]
    renderer: str
    first_paint_s: float
    interactive_s: float
    scene_shown_s: float
    ready_s: float
    bytes: dict[str, int]
    frames_per_s: float
    enter_to_glow_s: float
    server_pictures: dict[str, int]


@contextmanager
def opened(playwright: Playwright, *, webgl: bool) -> Iterator[Browser]:
    """Debian's Chromium, with software WebGL or without any.

    Raises:
        SystemExit: there is none.
    """
    path = shutil.which("chromium")
    if path is None:
        raise SystemExit("no chromium in this machine: apt-get install chromium")
    browser = playwright.chromium.launch(executable_path=path, args=list(_WEBGL if webgl else _NO_WEBGL))
    yield browser
    browser.close()


def visit(browser: Browser, url: str, scene_id: str, text: str, seconds: float) -> Visited:
    """Opens a scene in a new profile, orbits, and asks.

    Args:
        browser: which.
        url: of a server without keys, without a slash at its end.
        scene_id: which scene.
        text: a question that the scene answers.
        seconds: how long to orbit.
    """
    context = browser.new_context(viewport=_SIDES, reduced_motion="reduce")
    try:
        page = context.new_page()
        page.set_default_timeout(_PATIENCE_MS)
        page.add_init_script(_PROBE)
        sizes: Counter[str] = Counter()
        loaded: list[Request] = []
        page.on("requestfinished", lambda request: loaded.append(request))
        page.on("request", lambda request: sizes.update(_picture_size(request)))
        page.goto(f"{url}/#/scenes/{scene_id}")
        page.get_by_role("searchbox").wait_for()
        interactive = page.evaluate("() => performance.now()") / 1000
        page.locator("canvas[data-shown]").wait_for()
        picture_s = _awaited(page, "shown")
        begun = page.evaluate("() => performance.now()")
        page.keyboard.press("Shift")  # a gesture that moves nothing
        page.locator("canvas[data-drawn]").wait_for()
        ready = (page.evaluate("() => performance.now()") - begun) / 1000
        page.wait_for_timeout(2_000)
        transferred = _bytes(loaded)
        sizes.clear()
        frames = page.evaluate(_ORBIT, seconds)
        orbited = dict(sizes)
        page.wait_for_timeout(1_000)
        page.get_by_role("searchbox").fill(text)
        page.keyboard.press("Enter")
        page.locator("canvas[data-shown$=answer]").wait_for()
        glow = _awaited(page, "glowing") - page.evaluate("() => window.probe.entered") / 1000
        box = page.locator("canvas").bounding_box()
        assert box is not None
        return Visited(
            view=(round(box["width"]), round(box["height"])),
            renderer=page.evaluate(_RENDERER),
            first_paint_s=page.evaluate("() => performance.getEntriesByName('first-contentful-paint')[0].startTime")
            / 1000,
            interactive_s=interactive,
            scene_shown_s=picture_s,
            ready_s=ready,
            bytes=transferred,
            frames_per_s=frames,
            enter_to_glow_s=glow,
            server_pictures=orbited,
        )
    finally:
        context.close()


_RENDERER = """() => {
  const gl = document.createElement("canvas").getContext("webgl2");
  const names = gl?.getExtension("WEBGL_debug_renderer_info");
  return names ? gl.getParameter(names.UNMASKED_RENDERER_WEBGL) : "";
}"""


def _awaited(page: Page, name: str) -> float:
    """Seconds since the navigation began, of a moment that the probe notes; once it has."""
    while not (moment := page.evaluate(f"() => window.probe.{name}")):
        page.wait_for_timeout(20)
    return float(moment) / 1000


def _picture_size(request: Request) -> list[str]:
    if not request.url.endswith(":render"):
        return []
    camera: dict[str, Any] = json.loads(request.post_data or "{}")["camera"]["intrinsics"]
    return [f"{camera['width']}x{camera['height']}"]


def _bytes(requests: list[Request]) -> dict[str, int]:
    """Bytes of responses by kind: the page's own files by type; scene data by name."""
    kinds: Counter[str] = Counter()
    for request in requests:
        if request.url.startswith("blob:"):
            continue
        sizes = request.sizes()
        name = request.url.partition("?")[0].rpartition("/")[2]
        kind = "answers" if request.resource_type == "fetch" else request.resource_type
        if name in ("scene.spz", "scene.objects"):
            kind = name
        elif name.endswith(":render"):
            kind = "pictures"
        kinds[kind] += sizes["responseBodySize"] + sizes["responseHeadersSize"]
    return dict(kinds)
