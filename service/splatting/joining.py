"""Photos that join a finished scene: what they show is trained, Gaussians are made where it had nothing, and all else
stays as it is, to the bit.

A Gaussian that fills less than a pixel of every new photo is not changed. The new ones begin at the places that the new
photos agree on, where these are before what the scene has, and on the rays of the pixels that show less than half of
anything, at the depth of the nearest pixel that shows something or such a place; what is nearest to one of them,
whatever that belongs to, it belongs to. Gaussians that no photo of before shows are nothing: they begin nearly clear.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from fastsplat.service.capture.types import Capture, View
from fastsplat.service.common.dictionary import Dictionary
from fastsplat.service.common.progress import Progress
from fastsplat.service.perception.types import Labelling
from fastsplat.service.scene.scene_rows import appended_gaussians, gaussians_of_rows
from fastsplat.service.scene.types import SH_C0, Gaussians
from fastsplat.service.splatting.continuation import Continued, continue_training
from fastsplat.service.splatting.gaussians import splats_of
from fastsplat.service.splatting.photometric_training import with_colors_of
from fastsplat.service.splatting.previews import UNWATCHED, TrainingWatch
from fastsplat.service.splatting.pruning import max_contribution
from fastsplat.service.splatting.raster.checks import device_of
from fastsplat.service.splatting.raster.rendering import rasterize
from fastsplat.service.splatting.settings import TrainingSettings
from fastsplat.service.splatting.training_views import TrainingView, load_views, training_size
from fastsplat_contract.camera import Camera

_LEAST_PIXELS = 1.0
"""Σ of the blend weights of a Gaussian in a photo, from which on the photo shows it."""
_SOMETHING = 0.5
_SPACING = 4
"""Pixels between the rays on which Gaussians are made."""
_OPACITY = 0.5
_CLEAR = 0.02
"""Opacity that is left to what no photo of before shows."""
_UNSEEN = 0.01
"""As `_LEAST_PIXELS`, in every photo of before: less is not seen at all, however small these show what is near now."""
_BEFORE = 0.9
"""Of a depth: what is nearer than this is another surface."""
_SINGLE_TREE = 4  # FLANN_INDEX_KDTREE_SINGLE


def join_photos(
    gaussians: Gaussians,
    capture: Capture,
    joined: Collection[str],
    settings: TrainingSettings,
    progress: Progress,
    checkpoint_dir: Path | None = None,
    *,
    places: NDArray[np.float64],
    watch: TrainingWatch = UNWATCHED,
) -> Continued:
    """The scene with what some more photos show of it: half of the steps are theirs, the others keep the rest true.

    Args:
        gaussians: of the scene, in the capture's frame.
        capture: the photos that are kept with the scene, and the new ones.
        joined: names of the new ones.
        settings: see `continuation_settings`; the harmonics are the scene's.
        progress, checkpoint_dir, watch: as for `train`.
        places: float64 [P, 3], that the new photos agree on, in the capture's frame.

    Returns:
        The old rows, then the new ones, whose origins are the rows nearest to them; `changed` are those that were
        trained.

    Raises:
        FastSplatError: as `continue_training`.
    """
    new = [number for number, view in enumerate(capture.views) if view.posed.name in joined]
    old = [view for view in capture.views if view.posed.name not in joined]
    settings = settings.model_copy(update={"max_sh_degree": gaussians.sh_degree})
    unlabeled = Labelling(Dictionary(()), ())
    views = load_views(capture, unlabeled, tuple(new), settings.max_side, (1.0,))
    views = with_colors_of(gaussians, views, settings)
    changed = _shown(gaussians, [capture.views[number] for number in new], settings) >= _LEAST_PIXELS
    if old:
        gaussians = _cleared(gaussians, changed & (_shown(gaussians, old, settings) < _UNSEEN))
    # As many for a photo as the scene has for one of its own.
    most = len(gaussians) * len(new) // max(1, len(capture.views) - len(new))
    born, origins = born_gaussians(gaussians, views, changed, most, settings, places)
    begin = appended_gaussians(gaussians, born)
    weight = max(1, round((len(capture.views) - len(new)) / len(new)))
    repeated = replace(capture, views=(*capture.views, *(capture.views[number] for number in new * (weight - 1))))
    only = np.concatenate([changed, np.ones(len(born), np.bool_)])
    continued = continue_training(begin, repeated, settings, progress, checkpoint_dir, watch=watch, only=only)
    rows = np.concatenate([np.arange(len(gaussians)), origins])
    return replace(continued, origins=rows[continued.origins])


def _shown(gaussians: Gaussians, views: Sequence[View], settings: TrainingSettings) -> NDArray[np.float64]:
    """float64 [G], the pixels that each fills in the view that shows it best."""
    cameras = (
        (
            torch.from_numpy(view.posed.camera_from_world().astype(np.float32)),
            training_size(view.posed.camera, settings.max_side),
        )
        for view in views
    )
    return max_contribution(gaussians, cameras, settings.backend)


def _cleared(gaussians: Gaussians, rows: NDArray[np.bool_]) -> Gaussians:
    """The Gaussians, some of them at most nearly clear."""
    logits = gaussians.logit_opacities.copy()
    logits[rows] = np.minimum(logits[rows], math.log(_CLEAR / (1 - _CLEAR)))
    return replace(gaussians, logit_opacities=logits)


@torch.no_grad()
def born_gaussians(
    gaussians: Gaussians,
    views: Sequence[TrainingView],
    shown: NDArray[np.bool_],
    most: int,
    settings: TrainingSettings,
    agreed: NDArray[np.float64],
) -> tuple[Gaussians, NDArray[np.int64]]:
    """Gaussians where views show less than half of anything, or something nearer than the scene's surface, B of them,
    and int64 [B]: the rows nearest to them.

    Args:
        gaussians: of the scene, G of them.
        views: that look; a later one sees what was made for an earlier one.
        shown: bool [G], rows that may be the nearest.
        most: how many are made at most.
        settings: of the run.
        agreed: [P, 3], places of something that the views agree on.
    """
    made = gaussians_of_rows(gaussians, np.zeros(0, np.int64))
    if not shown.any():
        return made, np.zeros(0, np.int64)
    for view in views:
        places, depths, colors = _holes(appended_gaussians(gaussians, made), view, agreed, settings)
        if len(places) > most - len(made):
            step = np.linspace(0, len(places) - 1, max(0, most - len(made))).round().astype(np.int64)
            places, depths, colors = places[step], depths[step], colors[step]
        focal = view.frames[-1].camera.fx
        made = appended_gaussians(made, _new(places, depths * _SPACING / (2 * focal), colors, gaussians))
    rows = np.flatnonzero(shown)
    if not len(made):
        return made, np.zeros(0, np.int64)
    tree = cv2.flann.Index(gaussians.means[rows], {"algorithm": _SINGLE_TREE, "leaf_max_size": 10})
    nearest = tree.knnSearch(made.means, 1, params={"checks": -1, "eps": 0.0, "sorted": True})[0]
    return made, rows[np.asarray(nearest)[:, 0]]


def _holes(
    gaussians: Gaussians, view: TrainingView, agreed: NDArray[np.float64], settings: TrainingSettings
) -> tuple[NDArray[np.float32], NDArray[np.float64], NDArray[np.float32]]:
    """Places [B, 3] on the rays of every fourth pixel that shows nothing and of all pixels of places that are agreed on
    and are before what is shown, their camera z [B], and the photo's colors there [B, 3]."""
    frame, device = view.frames[-1], device_of(settings.backend)
    camera = frame.camera
    splats = splats_of(gaussians, torch.zeros(len(gaussians), 1, device=device), device)
    rendering = rasterize(splats, view.viewmat.to(device), camera, backend=settings.backend)
    alpha = rendering.alpha.cpu().numpy()
    depth = rendering.depth.cpu().numpy() / np.maximum(alpha, 1e-6)
    there = alpha >= _SOMETHING
    trained = np.ones_like(there) if frame.valid is None else frame.valid.cpu().numpy()
    viewmat = view.viewmat.cpu().numpy().astype(np.float64)
    row, column, z = _pixels(agreed @ viewmat[:3, :3].T + viewmat[:3, 3], camera)
    before = trained[row, column] & (~there[row, column] | (z < _BEFORE * depth[row, column]))
    row, column, z = row[before], column[before], z[before]
    nothing = ~there & trained
    there[row, column], depth[row, column], nothing[row, column] = True, z, False
    if not there.any():
        nothing[:] = False
    rows, columns = np.nonzero(nothing)
    grid = (rows % _SPACING == _SPACING // 2) & (columns % _SPACING == _SPACING // 2)
    rows, columns = rows[grid], columns[grid]
    _, labels = cv2.distanceTransformWithLabels(
        (~there).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
    )
    known = np.zeros(labels.max() + 1)
    known[labels[there]] = depth[there]
    z = np.concatenate([known[labels[rows, columns]], z]).astype(np.float64)
    row, column = np.concatenate([rows, row]), np.concatenate([columns, column])
    pose = np.linalg.inv(viewmat)
    local = camera.rays(column + 0.5, row + 0.5) * z[:, None]
    colors = np.asarray(frame.rgb.cpu().numpy()[row, column] / 255, np.float32)
    return (local @ pose[:3, :3].T + pose[:3, 3]).astype(np.float32), z, colors


def _pixels(
    local: NDArray[np.float64], camera: Camera
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.float64]]:
    """Row, column and z of the nearest of the points [P, 3], camera frame, in each pixel that has one."""
    local = local[local[:, 2] > 0]
    local = local[np.argsort(local[:, 2], kind="stable")]
    column, row = np.floor(local[:, :2] / local[:, 2:] * (camera.fx, camera.fy) + (camera.cx, camera.cy)).T
    inside = (row >= 0) & (row < camera.height) & (column >= 0) & (column < camera.width)
    pixels = (row[inside] * camera.width + column[inside]).astype(np.intp)
    pixels, first = np.unique(pixels, return_index=True)
    return pixels // camera.width, pixels % camera.width, local[inside, 2][first]


def _new(
    places: NDArray[np.float32], scales: NDArray[np.float64], colors: NDArray[np.float32], like: Gaussians
) -> Gaussians:
    count = len(places)
    sh = np.zeros((count, like.sh.shape[1], 3), np.float32)
    sh[:, 0] = (colors - 0.5) / SH_C0
    return Gaussians(
        means=places,
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
        log_scales=np.repeat(np.log(np.maximum(scales, 1e-12))[:, None], 3, axis=1).astype(np.float32),
        logit_opacities=np.full(count, math.log(_OPACITY / (1 - _OPACITY)), np.float32),
        sh=sh,
        codes=np.zeros((count, like.codes.shape[1]), np.float32),
    )
