"""A made room: three balls of one color each on a floor, photographed from a circle, and a segmenter by color."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch

from fastsplat.service.capture.captures import Capture, CaptureReport, View
from fastsplat.service.perception.results import Detections, Image, MaskLogits, Prompts
from fastsplat.service.scene.artefact.scene import SH_C0, Gaussians
from fastsplat.service.splatting.gaussians import splats_of
from fastsplat.service.splatting.raster.rendering import rasterize
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from fastsplat_contract.geometry.poses import look_at
from tests.instances.known_objects import gaussians_at, grid

CAMERA = Camera(96, 72, 80.0, 80.0, 48.0, 36.0)
COLORS = np.array([[0.5, 0.5, 0.5], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
NAMES = ("floor", "red ball", "green ball", "blue ball")
_CENTERS = np.array([[-0.6, 0.0, 0.25], [0.3, 0.5, 0.25], [0.3, -0.5, 0.25]])


@dataclass(frozen=True)
class Room:
    """A splat with photos; `owner` [G] is each Gaussian's object, 0 the floor; `maps` each pixel's, from 1."""

    gaussians: Gaussians
    owner: np.ndarray
    capture: Capture
    maps: tuple[np.ndarray, ...]


class ColorSegmenter:
    """Answers a point or box with the connected area of its color, thrice; notes prompts and colors of each image."""

    def __init__(self) -> None:
        self.prompts: list[int] = []
        self.pointed_at: list[int] = []

    def embed(self, image: Image) -> Image:
        self.prompts.append(0)
        return image

    def masks(self, embedding: Image, boxes: np.ndarray) -> np.ndarray:
        """Not asked here."""
        raise NotImplementedError

    def mask_logits(self, embedding: Image, prompts: Prompts) -> MaskLogits:
        """One step of the grid a pixel."""
        self.prompts[-1] += len(prompts)
        nearest = _nearest_color(embedding)
        logits = np.empty((len(prompts), 3, *nearest.shape), np.float32)
        for row, (x, y) in enumerate(_middles(prompts).astype(int)):
            if prompts.kinds[row, 0] == 1:
                self.pointed_at.append(int(nearest[y, x]))
            _, areas = cv2.connectedComponents((nearest == nearest[y, x]).astype(np.uint8))
            logits[row] = np.where(areas == areas[y, x], 8.0, -8.0)
        return MaskLogits(logits, np.full((len(prompts), 3), 0.95, np.float32), (1.0, 1.0))


class NoDetector:
    """Detects nothing."""

    labels = ()

    def detect(self, image: Image, min_score: float) -> Detections:
        return Detections(np.zeros((0, 4), np.float32), np.zeros(0, np.float32), ())


class BallDetector:
    """Detects the connected areas of the balls' colors, and calls each one a cup."""

    labels = ("cup",)

    def detect(self, image: Image, min_score: float) -> Detections:
        boxes = []
        for color in (2, 3, 4):
            _, _, stats, _ = cv2.connectedComponentsWithStats((_nearest_color(image) == color).astype(np.uint8))
            boxes += [(x, y, x + width, y + height) for x, y, width, height, area in stats[1:] if area > 20]
        array = np.array(boxes, np.float32).reshape(-1, 4)
        return Detections(array, np.full(len(array), 0.9, np.float32), ("cup",) * len(array))


def make_room(folder: Path, views: int = 8) -> Room:
    """The room, its photos written to `folder`."""
    rng = np.random.default_rng(3)
    parts = [grid(2.6, 2.6, 0.08)]
    for center in _CENTERS:
        directions = rng.normal(size=(250, 3))
        parts.append(center + 0.22 * directions / np.linalg.norm(directions, axis=1, keepdims=True))
    points = np.concatenate(parts)
    owner = np.repeat(np.arange(4), [len(part) for part in parts])
    bare = gaussians_at(points, 0.045)
    sh = ((COLORS[owner] - 0.5) / SH_C0).astype(np.float32)[:, None]
    gaussians = Gaussians(bare.means, bare.quats, bare.log_scales, bare.logit_opacities, sh, bare.codes)
    splats = splats_of(gaussians, torch.from_numpy(COLORS[owner].astype(np.float32)))
    room_views, maps = [], []
    for number in range(views):
        posed = PosedCamera(CAMERA, _pose(2 * np.pi * number / views), f"{number:03d}.png")
        viewmat = torch.from_numpy(posed.camera_from_world().astype(np.float32))
        drawn = rasterize(splats, viewmat, CAMERA)
        image = (drawn.image.clamp(0, 1) * 255).round().to(torch.uint8).numpy()
        cv2.imwrite(str(folder / posed.name), np.ascontiguousarray(image[:, :, ::-1]))
        room_views.append(View(posed, folder / posed.name))
        maps.append(np.where(drawn.alpha.numpy() > 0.5, _nearest_color(image), 0).astype(np.uint16))
    nothing = np.zeros((0, 3))
    report = CaptureReport("images", views)
    capture = Capture(tuple(room_views), nothing.astype(np.float32), nothing.astype(np.uint8), "METRIC", report)
    return Room(gaussians, owner, capture, tuple(maps))


def _middles(prompts: Prompts) -> np.ndarray:
    """[K, 2]: points, and the middles of boxes."""
    boxes = prompts.kinds[:, :1] == 2
    return np.where(boxes, prompts.points.mean(axis=1), prompts.points[:, 0])


def _nearest_color(image: Image) -> np.ndarray:
    """[H, W]: number of the nearest color, counted from 1; 0 for black."""
    known = np.concatenate([np.zeros((1, 3)), COLORS]) * 255
    return np.asarray(((image[:, :, None] - known) ** 2).sum(axis=-1).argmin(axis=-1))


def _pose(angle: float) -> np.ndarray:
    """World-from-camera of a level camera two meters away that looks down at the middle."""
    position = np.array([2.0 * np.cos(angle), 2.0 * np.sin(angle), 1.5])
    return look_at(position, (0.0, 0.0, 0.1))
