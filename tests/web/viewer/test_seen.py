"""The camera stays where pictures show what photos have seen, and flies to where an object is seen whole."""

from __future__ import annotations

import io
import itertools
import random
import re
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from playwright.sync_api import Browser, expect

from fastsplat.service.settings import Settings
from fastsplat.service.store.care.sample_scene import unpack_sample
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.geometry.poses import Box
from fastsplat_contract.photos.pictures import PictureRequest
from tests.web.browser import visiting
from tests.web.glow import scene_up, view_camera
from tests.web.places import Place, running

_ENCODER = "minilm_l6_int8"
_GESTURES = 200
_KEYS = ["ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown", *"wasdeq+-"]
_PERFORMED = """
(canvas, gestures) => gestures.map(([key, shift, times]) => {
  for (let time = 0; time < times; time++)
    canvas.dispatchEvent(key === "wheel"
      ? new WheelEvent("wheel", { deltaY: shift ? 120 : -120, cancelable: true })
      : new KeyboardEvent("keydown", { key, shiftKey: shift }));
  return canvas.dataset.view;
})
"""
"""Keys and wheel on the 3D view; the view after each gesture."""


@pytest.fixture(scope="module")
def sample(browser: Browser, models_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Place]:
    """A server with the sample scene alone."""
    if not (models_dir / _ENCODER).is_dir():
        pytest.skip(f"FASTSPLAT_MODELS has no {_ENCODER}")
    folder = tmp_path_factory.mktemp("sample") / "data"
    unpack_sample(folder)
    ports = {"http_port": 0, "grpc_port": 0, "metrics_port": 0}
    with running(Settings(data_dir=folder, models=models_dir, auth="off", **ports)) as place:
        (scene,) = place.service.list_scenes().scenes
        yield replace(place, scene_id=scene.id)


class _Covered:
    """How much of a picture shows surfaces that two photos show: by the server's depths alone."""

    def __init__(self, place: Place) -> None:
        self._place = place
        cameras = place.service.get_scene(place.scene_id).cameras
        self._up = scene_up(cameras)
        self._photos = [(posed, self._depth(posed)) for posed in (posed.limited_to(96) for posed in cameras)]

    def camera(self, text: str, size: dict[str, float], width: int = 64) -> PosedCamera:
        """Of a view as the page says it, in a window of this shape."""
        view = np.array([float(number) for number in text.split("_")])
        return view_camera(view, width, round(width * size["height"] / size["width"]), self._up)

    def shares(self, views: Iterable[str], size: dict[str, float]) -> list[float]:
        """The shares of the pixels of different views, 0..1, ascending."""
        return sorted(self._share(self.camera(view, size)) for view in set(views))

    def _share(self, posed: PosedCamera) -> float:
        depth = self._depth(posed)
        y, x = np.nonzero(depth > 0)
        points = posed.places(x + 0.5, y + 0.5, depth[y, x])
        seen = np.zeros(len(points), dtype=int)
        for photo, photo_depth in self._photos:
            rows, pixels, z = photo.in_picture(points)
            front = photo_depth[pixels[:, 1].astype(int), pixels[:, 0].astype(int)]
            seen[rows] += (front > 0) & (np.abs(z - front) < 0.05 * front)
        return float((seen >= 2).sum() / depth.size)

    def _depth(self, posed: PosedCamera) -> NDArray[np.float32]:
        request = PictureRequest(self._place.scene_id, "depth", camera=posed, format="npy")
        return np.nan_to_num(np.load(io.BytesIO(self._place.service.answers.picture(request))))


def _corners(box: Box) -> NDArray[np.float64]:
    matrix = box.center.matrix()
    signs = np.array(list(itertools.product((-0.5, 0.5), repeat=3)))
    return np.asarray((signs * np.array(box.size)) @ matrix[:3, :3].T + matrix[:3, 3])


def _gestures(seed: int, count: int) -> list[list[object]]:
    draw = random.Random(seed)
    return [[draw.choice([*_KEYS, "wheel"]), draw.random() < 0.4, draw.randint(1, 8)] for _ in range(count)]


def test_no_gesture_leaves_what_was_seen_and_objects_are_flown_to_whole(sample: Place, webgl_browser: Browser) -> None:
    listed, covered = sample.service.answers.list_objects(sample.scene_id).objects, _Covered(sample)
    with visiting(webgl_browser, sample.url, f"#/scenes/{sample.scene_id}", device_scale_factor=0.25) as visit:
        canvas = visit.page.locator("canvas[role=application]")
        expect(canvas).to_have_attribute("data-shown", re.compile("plain$"))
        strayed = canvas.evaluate(_PERFORMED, [["ArrowLeft", False, 20]])  # before the page knows what photos saw
        visit.scene_shown()
        expect(canvas).not_to_have_attribute("data-view", strayed[0])
        early = canvas.get_attribute("data-view") or ""
        box = canvas.bounding_box()
        views = [early, *canvas.evaluate(_PERFORMED, _gestures(5, _GESTURES))]
        rows = visit.tab("Objects").locator(".object-list li")
        for row, obj in enumerate(listed):
            if obj.kind != "object" or not obj.name or obj.box is None:
                continue
            before = canvas.get_attribute("data-view") or ""
            rows.nth(row).get_by_role("button").click()
            expect(canvas).not_to_have_attribute("data-view", before)
            views.append(canvas.get_attribute("data-view") or "")
            posed = covered.camera(views[-1], box, 640)
            assert len(posed.in_picture(_corners(obj.box))[0]) == 8, obj.name
    assert covered.shares(strayed, box)[0] < 0.5
    shares = covered.shares(views, box)
    assert len(shares) > _GESTURES / 4  # the camera is no prisoner
    assert shares[0] >= 0.6, shares[:5]


def test_where_the_server_draws_no_gesture_leaves_what_was_seen(sample: Place, browser: Browser) -> None:
    with visiting(browser, sample.url, f"#/scenes/{sample.scene_id}", device_scale_factor=0.25) as visit:
        assert visit.page.evaluate("document.createElement('canvas').getContext('webgl2')") is None
        canvas = visit.scene_shown()
        expect(canvas).to_have_attribute("data-drawn", "server")
        box = canvas.bounding_box()
        views = canvas.evaluate(_PERFORMED, _gestures(6, 60))
    shares = _Covered(sample).shares(views, box)
    assert len(shares) > 60 / 4
    assert shares[0] >= 0.6, shares[:5]


def test_an_idle_view_turns_within_what_was_seen_until_the_first_touch(sample: Place, webgl_browser: Browser) -> None:
    options = {"device_scale_factor": 0.25, "reduced_motion": "no-preference"}
    with visiting(webgl_browser, sample.url, f"#/scenes/{sample.scene_id}", **options) as visit:
        canvas = visit.page.locator("canvas[role=application]")
        expect(canvas).to_have_attribute("data-drawn", "webgl", timeout=60_000)
        views = [canvas.get_attribute("data-view") or ""]
        for _ in range(3):
            expect(canvas).not_to_have_attribute("data-view", views[-1])
            views.append(canvas.get_attribute("data-view") or "")
        visit.page.keyboard.press("Shift")
        views.append(canvas.get_attribute("data-view") or "")
        visit.at_rest()
        assert canvas.get_attribute("data-view") == views[-1]
        box = canvas.bounding_box()
    assert _Covered(sample).shares(views, box)[0] >= 0.6


def test_what_names_a_candidate_stands_beside_it(sample: Place, browser: Browser) -> None:
    with visiting(browser, sample.url, f"#/scenes/{sample.scene_id}?q=submarine") as visit:
        rows = visit.page.locator(".candidate", has_text="Yes, it is")
        expect(rows.nth(5)).to_be_visible()
        for row in rows.all():
            look, name = (button.bounding_box() for button in row.get_by_role("button").all())
            assert look and name and look["x"] + look["width"] <= name["x"]
            assert look["y"] < name["y"] + name["height"] / 2 < look["y"] + look["height"]
        visit.check_accessible()
