"""Compares what glows on the page with the server's mask of it.

Mask: the object has the largest blended membership, and the scene covers at least half of the pixel. Glow: the object's
Gaussians are more than `GLOWS` of the pixel's color; less than half, as three objects may meet in one pixel.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from urllib.parse import parse_qs

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from playwright.sync_api import Page

from fastsplat.service.common.vertical import vertical_of_poses
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from fastsplat_contract.messages.queries import QueryRequest
from fastsplat_contract.photos.pictures import PictureRequest
from tests.web.browser import drawn_canvas
from tests.web.places import Place
from tests.web.table import looking

GLOWS = 0.4
_DIMMED = 0.45
_FIELD_OF_VIEW = np.radians(55.0)
# As the page has them: api/web/src/viewer/glow.ts and poses.ts.
FOUND = ((1.0, 0.56, 0.06), 0.75)
SELECTED = ((0.1, 0.55, 1.0), 0.65)


def canvas_pixels(page: Page) -> NDArray[np.float64]:
    """The 3D picture that is shown, without what lies over it: [H, W, 3] of 0..1."""
    page.evaluate("""() => {
      const sheet = new CSSStyleSheet();
      sheet.replaceSync(".glow-legend, .viewer-note, .gizmo { display: none }");
      document.adoptedStyleSheets = [sheet];
    }""")
    picture = drawn_canvas(page)
    page.evaluate("() => { document.adoptedStyleSheets = []; }")
    return pixels_of(picture) / 255


def pixels_of(content: bytes) -> NDArray[np.float64]:
    """A picture file as [H, W, 3] of 0..255."""
    return np.asarray(Image.open(io.BytesIO(content)).convert("RGB"), dtype=np.float64)


def glowing(
    plain: NDArray[np.float64], picture: NDArray[np.float64], tint: tuple[tuple[float, ...], float] = FOUND
) -> NDArray[np.bool_]:
    """bool [H, W]: of which pixels more than `GLOWS` glows, as best explains `picture` shows of what was `plain`."""
    color, strength = tint
    dimmed = _DIMMED * plain
    way = (1 - strength) * plain + strength * np.array(color) - dimmed
    share = ((picture - dimmed) * way).sum(axis=2) / (way**2).sum(axis=2)
    return np.asarray(share > GLOWS)


def page_view(page: Page) -> NDArray[np.float64]:
    """[6]: position and target of the page's camera, read from its address."""
    view = parse_qs(page.url.partition("?")[2])["view"][0]
    return np.array([float(number) for number in view.split("_")])


def page_camera(page: Page, width: int, height: int, up: tuple[float, float, float] = (0.0, 0.0, 1.0)) -> PosedCamera:
    """Where the page looks from, as the service takes it."""
    return view_camera(page_view(page), width, height, up)


def view_camera(
    view: NDArray[np.float64], width: int, height: int, up: tuple[float, float, float] = (0.0, 0.0, 1.0)
) -> PosedCamera:
    """The camera of a view [6], position and target, as the page's canvas of this size shows it."""
    focal = max(width, height) / 2 / np.tan(_FIELD_OF_VIEW / 2)
    return looking(view[:3], view[3:], Camera(width, height, focal, focal, width / 2, height / 2), up)


def server_mask(place: Place, posed: PosedCamera, name: str) -> NDArray[np.bool_]:
    """bool [H, W]: where the server finds what is called so, from a camera."""
    request = QueryRequest(place.scene_id, (name,), cameras=(posed,), outputs=frozenset({"mask2d"}))
    (answer,) = place.service.answers.query(request).answers
    return answer.masks[0].array()


def server_pixels(place: Place, posed: PosedCamera) -> NDArray[np.float64]:
    """The server's picture from a camera, as [H, W, 3] of 0..255."""
    return pixels_of(place.service.answers.picture(PictureRequest(place.scene_id, "rgb", camera=posed)))


def overlap(first: NDArray[np.bool_], second: NDArray[np.bool_]) -> float:
    """Intersection over union."""
    return float((first & second).sum() / (first | second).sum())


def scene_up(cameras: Sequence[PosedCamera]) -> tuple[float, float, float]:
    """What is up in a scene, as the page takes it: in which direction the horizons of its pictures are level."""
    up = vertical_of_poses(np.stack([posed.world_from_camera for posed in cameras]))
    assert up is not None
    return float(up[0]), float(up[1]), float(up[2])
