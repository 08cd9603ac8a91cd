"""Loads a capture's images, label maps and masks at the sizes used in training."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor

from fastsplat.service.capture.captures import Capture, View
from fastsplat.service.capture.formats.depth_maps import load_depth, resample_depth
from fastsplat.service.capture.formats.image_io import load_rgb  # `capture.build.load_image` imports far more
from fastsplat.service.common.dictionary import UNDETECTED
from fastsplat.service.perception.results import Labelling
from fastsplat.service.splatting.raster.image_formation import Backend, Rendering, Splats
from fastsplat.service.splatting.raster.rendering import rasterize, sh_to_rgb
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.geometry.camera import Camera


@dataclass(frozen=True)
class Frame:
    """A view at one size."""

    camera: Camera
    rgb: Tensor  # uint8 [H, W, 3]
    labels: Tensor | None  # uint8 or int32 [H, W], 0 undetected; None without labels
    valid: Tensor | None  # bool [H, W]; None if every pixel has content
    depth: Tensor | None = None  # float32 [H, W], sensor camera z, scene units, 0 where unknown

    def target(self) -> Tensor:
        """Returns the image as float32 [H, W, 3], 0..1."""
        return self.rgb.to(torch.float32).mul_(1 / 255)

    @property
    def has_content(self) -> bool:
        """True if any pixel is valid."""
        return self.valid is None or bool(self.valid.any())

    def to(self, device: torch.device) -> Frame:
        optional = (self.labels, self.valid, self.depth)
        moved = (None if tensor is None else tensor.to(device) for tensor in optional)
        return Frame(self.camera, self.rgb.to(device), *moved)


@dataclass(frozen=True)
class TrainingView:
    """A view at all sizes."""

    name: str
    viewmat: Tensor  # [4, 4], camera-from-world
    position: Tensor  # [3], world frame
    frames: tuple[Frame, ...]  # from the smallest size to the training size
    exposure_ev: float | None = None  # see `service.capture.captures.View`

    def to(self, device: torch.device) -> TrainingView:
        frames = tuple(frame.to(device) for frame in self.frames)
        viewmat, position = self.viewmat.to(device), self.position.to(device)
        return TrainingView(self.name, viewmat, position, frames, self.exposure_ev)


def split_views(count: int, every: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Splits view indices into training and held-out ones, the middle of each `every`.

    None are held out if `every` is below 2 or there are fewer than 4 views; otherwise at least one is.
    """
    if every < 2 or count < 4:
        return tuple(range(count)), ()
    every = min(every, count)
    held_out = tuple(range(every // 2, count, every))
    return tuple(index for index in range(count) if index not in held_out), held_out


def capture_split(capture: Capture, every: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Splits view indices into training and held-out ones.

    Holds out the capture's own test views, else those of `split_views`; none for `every` = 0.
    """
    apart = set(capture.test_names)
    held_out = tuple(index for index, view in enumerate(capture.views) if view.posed.name in apart)
    if not every or not held_out or len(held_out) == len(capture.views):
        return split_views(len(capture.views), every)
    return tuple(index for index in range(len(capture.views)) if index not in held_out), held_out


def load_views(
    capture: Capture, labelling: Labelling, indices: tuple[int, ...], max_side: int, scales: tuple[float, ...]
) -> tuple[TrainingView, ...]:
    """Loads views at each of `scales` (ascending to 1) of the training size.

    The training size is the image's own, reduced to `max_side` pixels on the longer side.

    Raises:
        InvalidInputError: an image, mask or label map differs in size from its camera.
    """
    maps = labelling.label_maps if len(labelling.dictionary) else ()
    return tuple(_load_view(capture.views[i], maps[i] if maps else None, max_side, scales) for i in indices)


def drop_empty_label_maps(views: Sequence[TrainingView]) -> tuple[TrainingView, ...]:
    """Drops label maps without labels: no detector saw the view, or found anything."""
    return tuple(
        view
        if view.frames[-1].labels is None or bool(view.frames[-1].labels.any())
        else replace(view, frames=tuple(replace(frame, labels=None) for frame in view.frames))
        for view in views
    )


def training_size(camera: Camera, max_side: int, scale: float = 1.0) -> Camera:
    """Scales a camera to at most `max_side`, then by `scale`; never enlarges."""
    factor = min(1.0, max_side / max(camera.width, camera.height)) * scale
    if factor == 1.0:
        return camera
    return camera.scaled_to(max(1, round(camera.width * factor)), max(1, round(camera.height * factor)))


def _load_view(
    view: View, label_map: NDArray[np.uint16] | None, max_side: int, scales: tuple[float, ...]
) -> TrainingView:
    camera, name = view.posed.camera, view.posed.name
    rgb = load_rgb(view.image_path)
    _check_size(rgb, camera, f"image {name}")
    valid = None
    if view.valid_path is not None:
        with Image.open(view.valid_path) as image:
            valid = np.asarray(image.convert("L"))
        _check_size(valid, camera, f"mask of image {name}")
    if label_map is not None:
        _check_size(label_map, camera, f"label map of image {name}")
    frames = tuple(_frame(rgb, label_map, valid, training_size(camera, max_side, scale)) for scale in scales)
    if view.depth is not None:
        measured = load_depth(view.depth)
        frames = tuple(
            replace(frame, depth=torch.from_numpy(resample_depth(measured, view.depth.camera, frame.camera)))
            for frame in frames
        )
    viewmat = torch.from_numpy(view.posed.camera_from_world().astype(np.float32))
    position = torch.from_numpy(view.posed.world_from_camera[:3, 3].astype(np.float32))
    return TrainingView(name, viewmat, position, frames, view.exposure_ev)


def _check_size(pixels: NDArray[np.generic], camera: Camera, what: str) -> None:
    if pixels.shape[:2] != (camera.height, camera.width):
        raise InvalidInputError.of(
            what,
            f"has {pixels.shape[1]}×{pixels.shape[0]} pixels, its camera {camera.width}×{camera.height}",
            "Give every image, mask and label map the size its camera states.",
        )


def _frame(
    rgb: NDArray[np.uint8], labels: NDArray[np.uint16] | None, valid: NDArray[np.uint8] | None, camera: Camera
) -> Frame:
    size = (camera.width, camera.height)
    if size != (rgb.shape[1], rgb.shape[0]):
        # Area averaging simulates a smaller sensor; labels cannot be averaged.
        rgb = np.asarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA))
        labels = None if labels is None else np.asarray(cv2.resize(labels, size, interpolation=cv2.INTER_NEAREST))
        valid = None if valid is None else np.asarray(cv2.resize(valid, size, interpolation=cv2.INTER_AREA))
    if valid is not None and labels is not None:
        labels = np.where(valid == 255, labels, np.uint16(UNDETECTED))
    return Frame(
        camera=camera,
        rgb=torch.from_numpy(rgb.copy()),
        labels=None if labels is None else torch.from_numpy(smallest_labels(labels)),
        valid=None if valid is None else torch.from_numpy(valid == 255),
    )


def smallest_labels(labels: NDArray[np.integer]) -> NDArray[np.uint8 | np.int32]:
    """Copies labels to the smallest dtype that torch can index with."""
    return labels.astype(np.uint8) if labels.max(initial=0) < 256 else labels.astype(np.int32)


def squared_depths(means: Tensor, viewmat: Tensor) -> Tensor:
    """Returns squared camera z [G, 1] to composite as a feature, differentiable in the means."""
    z = means @ viewmat[2, :3] + viewmat[2, 3]
    return (z * z)[:, None]


def render_frame(
    parameters: Mapping[str, Tensor],  # colors and codes, see `SplatState`
    splats: Splats,  # activated `parameters`; features are ignored
    view: TrainingView,
    frame: Frame,
    *,
    degree: int,
    with_codes: bool = False,  # append composited codes, [H, W, 3 + D]
    with_squared_depth: bool = False,  # append composited squared camera z
    backend: Backend,
) -> Rendering:
    """Renders the view at the size of `frame`: RGB, then optional further channels."""
    sh = parameters["sh_dc"]
    if degree:
        sh = torch.cat([sh, parameters["sh_rest"][:, : (degree + 1) ** 2 - 1]], dim=1)
    features = sh_to_rgb(parameters["means"], sh, view.position, degree, backend=backend)
    if with_codes:
        features = torch.cat([features, parameters["codes"]], dim=1)
    if with_squared_depth:
        features = torch.cat([features, squared_depths(parameters["means"], view.viewmat)], dim=1)
    return rasterize(replace(splats, features=features), view.viewmat, frame.camera, backend=backend)
