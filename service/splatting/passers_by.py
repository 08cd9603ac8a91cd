"""What only a few photos show, without a detector's word: pixels that contradict the other photos of the same surface.

A passer-by hides a surface in few views. Seen from the other views the surface has another color there, and the other
views agree. So every pixel of a training view is compared with the median of the colors that the other views have where
its surface lies, by the depth of the run so far; what differs by more than the others differ among each other, over an
area rather than at an edge, is left out of the loss.

Median and spread over views, area votes and late growth follow robust 3D reconstruction: RobustNeRF (Sabour et al.,
CVPR 2023) trims pixels by their residuals and lets neighborhoods vote; SpotLessSplats (Sabour et al., 2024) masks whole
regions and lets Gaussians grow late. Unlike a trimmed loss, which leaves out a fixed share of every photo, a scene in
which nothing moves loses nothing here: without agreement of the others against it no pixel is left out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fastsplat.service.splatting.gaussians import splats_of
from fastsplat.service.splatting.objective import render_frame
from fastsplat.service.splatting.raster import Backend
from fastsplat.service.splatting.settings import TrainingSettings
from fastsplat.service.splatting.state import SplatState, Step
from fastsplat.service.splatting.strategy import DensificationStrategy
from fastsplat.service.splatting.training_views import TrainingView
from fastsplat_contract.camera import Camera

_MIN_SUPPORT = 4
_SAME_SURFACE = 0.05
_LEAST_DIFFERENCE = 0.1
_SPREADS = 3.0
_LEAST_RESIDUAL = 0.1
_VOTE = 0.02
_LEAST_AREA = 0.003
_RIM = 0.025
_MOST = 0.35
_ALPHA_MIN = 0.5
_PREFIX = "passers_by."

LOOKS = (0.15, 0.25, 0.4)
"""Progress at which passers-by are looked for."""
GROWTH_FROM = 0.25
"""Progress from which Gaussians are added where there are some."""


@dataclass(frozen=True)
class _SeenView:
    """A view as it is compared with others: blurred colors [h, w, 3] 0..1, depth [h, w] (0: none), both float32."""

    camera: Camera
    viewmat: NDArray[np.float64]
    colors: NDArray[np.float32]
    depth: NDArray[np.float32]
    residual: NDArray[np.float32]
    valid: NDArray[np.bool_] | None


@torch.no_grad()
def contradicting_pixels(
    parameters: Mapping[str, Tensor], views: Sequence[TrainingView], backend: Backend
) -> list[NDArray[np.bool_]]:
    """bool [h, w] of each view, of its smallest frame: true where it contradicts the others.

    Args:
        parameters: of a run whose geometry is roughly right, see `SplatState`.
        views: training views, with their masks as the capture has them.
        backend: which rasterizer.
    """
    splats = splats_of(parameters)
    seen = [_seen(parameters, splats, view, backend) for view in views]
    masks = [_contradictions(index, seen) for index in range(len(seen))]
    if np.mean([mask.mean() for mask in masks]) > _MOST:  # then it is the geometry that is wrong
        return [np.zeros_like(mask) for mask in masks]
    return masks


def _seen(parameters: Mapping[str, Tensor], splats: object, view: TrainingView, backend: Backend) -> _SeenView:
    frame = view.frames[0]
    rendering = render_frame(parameters, splats, view, frame, degree=0, backend=backend)  # type: ignore[arg-type]
    alpha = rendering.alpha.cpu().numpy()
    if rendering.median_depth is not None:
        depth = rendering.median_depth.cpu().numpy()
    else:
        depth = (rendering.depth / rendering.alpha.clamp_min(1e-6)).cpu().numpy()
    colors = frame.target().cpu().numpy()
    residual = np.abs(rendering.image.cpu().numpy() - colors).mean(-1)
    return _SeenView(
        frame.camera,
        view.viewmat.cpu().numpy().astype(np.float64),
        np.asarray(cv2.blur(colors, (3, 3))),
        np.where(alpha > _ALPHA_MIN, depth, 0).astype(np.float32),
        np.asarray(cv2.blur(residual, (5, 5))),
        None if frame.valid is None else frame.valid.cpu().numpy(),
    )


def _contradictions(index: int, seen: Sequence[_SeenView]) -> NDArray[np.bool_]:
    own = seen[index]
    height, width = own.depth.shape
    rows, columns = np.mgrid[0:height, 0:width]
    rays = np.stack(
        [(columns + 0.5 - own.camera.cx) / own.camera.fx, (rows + 0.5 - own.camera.cy) / own.camera.fy, rows * 0 + 1.0],
        axis=-1,
    )
    world_from_camera = np.linalg.inv(own.viewmat)
    points = (rays * own.depth[..., None]) @ world_from_camera[:3, :3].T + world_from_camera[:3, 3]
    others = [_colors_at(points, own.depth > 0, other) for number, other in enumerate(seen) if number != index]
    colors = np.stack(others)  # NaN where a view does not see the surface
    support = np.isfinite(colors[..., 0]).sum(0)
    agreed = support >= _MIN_SUPPORT
    if own.valid is not None:
        agreed &= own.valid
    if not agreed.any():
        return np.zeros((height, width), np.bool_)
    with np.errstate(all="ignore"):
        import warnings

        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)
            median = np.nanmedian(colors, axis=0)
            spread = np.nanmedian(np.abs(colors - median).mean(-1), axis=0)
    gain = np.median((median[agreed] + 0.02) / (own.colors[agreed] + 0.02), axis=0)  # of exposure and white balance
    difference = np.abs((own.colors + 0.02) * gain - 0.02 - median).mean(-1)
    contradicts = (
        agreed & (own.residual > _LEAST_RESIDUAL) & (difference > np.maximum(_LEAST_DIFFERENCE, _SPREADS * spread))
    )
    return _areas(contradicts, agreed)


def _colors_at(points: NDArray[np.float64], known: NDArray[np.bool_], other: _SeenView) -> NDArray[np.float32]:
    camera_points = points @ other.viewmat[:3, :3].T + other.viewmat[:3, 3]
    z = camera_points[..., 2]
    front = known & (z > 1e-6)
    safe = np.where(front, z, 1.0)
    x = np.floor(camera_points[..., 0] / safe * other.camera.fx + other.camera.cx)
    y = np.floor(camera_points[..., 1] / safe * other.camera.fy + other.camera.cy)
    height, width = other.depth.shape
    inside = front & (x >= 0) & (x < width) & (y >= 0) & (y < height)
    column, row = np.where(inside, x, 0).astype(int), np.where(inside, y, 0).astype(int)
    visible = inside & (np.abs(other.depth[row, column] - z) < _SAME_SURFACE * safe)
    if other.valid is not None:
        visible &= other.valid[row, column]
    return np.where(visible[..., None], other.colors[row, column], np.float32(np.nan))


def _areas(contradicts: NDArray[np.bool_], agreed: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Where most of a neighborhood contradicts, in pieces of some size, with a rim and without holes."""
    height, width = contradicts.shape
    side = 2 * max(1, round(_VOTE * max(height, width))) + 1
    votes = cv2.blur(contradicts.astype(np.float32), (side, side))
    weight = cv2.blur(agreed.astype(np.float32), (side, side))
    voted = (votes > 0.5 * np.maximum(weight, 0.2)).astype(np.uint8)
    count, labels, statistics, _ = cv2.connectedComponentsWithStats(voted)
    large = np.flatnonzero(statistics[:, cv2.CC_STAT_AREA] >= _LEAST_AREA * height * width)
    kept = np.isin(labels, large[large > 0]) if count > 1 else np.zeros(contradicts.shape, np.bool_)
    rim = max(1, round(_RIM * max(height, width)))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * rim + 1, 2 * rim + 1))
    return np.asarray(cv2.dilate(kept.astype(np.uint8), disc) > 0)


class PassersBy:
    """The passers-by of a run: looked for at a few moments, and left out of the views from then on.

    Args:
        views: training views as they were loaded.
        settings: the run's.

    Attributes:
        contradicting: share of each training view that is left out at present, 0 where nothing is.
    """

    def __init__(self, views: Sequence[TrainingView], settings: TrainingSettings) -> None:
        self._settings = settings
        self._valid = [[frame.valid for frame in view.frames] for view in views]
        self._looks = 0
        self._masks: list[NDArray[np.bool_]] = []
        self.contradicting: tuple[float, ...] = (0.0,) * len(self._valid)

    @property
    def suspected(self) -> bool:
        """Whether anything is left out."""
        return any(self.contradicting)

    def mask_if_due(
        self, progress: float, state: SplatState, views: tuple[TrainingView, ...]
    ) -> tuple[TrainingView, ...]:
        """The views, at a moment of `LOOKS` with what contradicts the others masked anew."""
        due = sum(progress >= moment for moment in LOOKS)
        if self._settings.passers_by == "keep" or due <= self._looks or len(views) <= _MIN_SUPPORT:
            return views
        self._looks = due
        bare = [self._with_valid(view, index, None) for index, view in enumerate(views)]
        return self._masked(views, contradicting_pixels(state.parameters, bare, self._settings.backend))

    def tensors(self) -> dict[str, Tensor]:
        """What a checkpoint must hold."""
        masks = {f"{_PREFIX}{index}": torch.from_numpy(mask) for index, mask in enumerate(self._masks)}
        return masks | {f"{_PREFIX}looks": torch.tensor(self._looks)}

    def restore(
        self, tensors: Mapping[str, Tensor], views: tuple[TrainingView, ...]
    ) -> tuple[dict[str, Tensor], tuple[TrainingView, ...]]:
        """A checkpoint's other tensors, and the views with its masks."""
        others = {name: value for name, value in tensors.items() if not name.startswith(_PREFIX)}
        self._looks = int(tensors.get(f"{_PREFIX}looks", torch.tensor(0)))
        if f"{_PREFIX}0" not in tensors:
            return others, views
        return others, self._masked(views, [tensors[f"{_PREFIX}{index}"].numpy() for index in range(len(views))])

    def late(self, strategy: DensificationStrategy) -> DensificationStrategy:
        """The strategy, which rests until `GROWTH_FROM` where passers-by are suspected."""
        return _LateGrowth(strategy, self)

    def quality(self) -> dict[str, float]:
        """contradicting_views, contradicting_share: how many views have passers-by, and what share of all pixels."""
        if not self.suspected:
            return {}
        views = float(sum(share > 0 for share in self.contradicting))
        return {"contradicting_views": views, "contradicting_share": float(np.mean(self.contradicting))}

    def _masked(self, views: tuple[TrainingView, ...], masks: Sequence[NDArray[np.bool_]]) -> tuple[TrainingView, ...]:
        self._masks = list(masks)
        self.contradicting = tuple(float(mask.mean()) for mask in masks)
        return tuple(
            self._with_valid(view, index, mask if mask.any() else None)
            for index, (view, mask) in enumerate(zip(views, masks, strict=True))
        )

    def _with_valid(self, view: TrainingView, index: int, mask: NDArray[np.bool_] | None) -> TrainingView:
        frames = []
        for frame, own in zip(view.frames, self._valid[index], strict=True):
            valid = own
            if mask is not None:
                size = (frame.camera.width, frame.camera.height)
                resized = cv2.resize(mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST)
                use = torch.from_numpy(resized == 0).to(frame.rgb.device)
                valid = use if own is None else own.to(use.device) & use
            frames.append(replace(frame, valid=None if valid is None else valid.to(frame.rgb.device)))
        return replace(view, frames=tuple(frames))


@dataclass(frozen=True)
class _LateGrowth:
    strategy: DensificationStrategy
    passers_by: PassersBy

    def step_post_backward(self, state: SplatState, step: Step) -> None:
        """See `DensificationStrategy`."""
        if not (self.passers_by.suspected and step.progress < GROWTH_FROM):
            self.strategy.step_post_backward(state, step)
