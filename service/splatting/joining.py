"""Photos that join a finished scene: what they show is trained, Gaussians are made where it had nothing, and all else
stays as it is, to the bit.

A Gaussian that fills less than a pixel of every new photo is not changed. The new ones begin on the rays of the pixels
that show less than half of anything, at the depth of the nearest pixel that shows something; what is nearest to one of
them, whatever that belongs to, it belongs to.
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

from fastsplat.service.capture.types import Capture
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
from fastsplat.service.splatting.training_views import TrainingView, load_views

_LEAST_PIXELS = 1.0
"""Σ of the blend weights of a Gaussian in a photo, from which on the photo shows it."""
_SOMETHING = 0.5
_SPACING = 4
"""Pixels between the rays on which Gaussians are made."""
_OPACITY = 0.5
_SINGLE_TREE = 4  # FLANN_INDEX_KDTREE_SINGLE


def join_photos(
    gaussians: Gaussians,
    capture: Capture,
    joined: Collection[str],
    settings: TrainingSettings,
    progress: Progress,
    checkpoint_dir: Path | None = None,
    *,
    watch: TrainingWatch = UNWATCHED,
) -> Continued:
    """The scene with what some more photos show of it: half of the steps are theirs, the others keep the rest true.

    Args:
        gaussians: of the scene, in the capture's frame.
        capture: the photos that are kept with the scene, and the new ones.
        joined: names of the new ones.
        settings: see `continuation_settings`; the harmonics are the scene's.
        progress, checkpoint_dir, watch: as for `train`.

    Returns:
        The old rows, then the new ones, whose origins are the rows nearest to them; `changed` are those that were
        trained.

    Raises:
        FastSplatError: as `continue_training`.
    """
    new = [number for number, view in enumerate(capture.views) if view.posed.name in joined]
    settings = settings.model_copy(update={"max_sh_degree": gaussians.sh_degree})
    unlabeled = Labelling(Dictionary(()), ())
    views = load_views(capture, unlabeled, tuple(new), settings.max_side, (1.0,))
    views = with_colors_of(gaussians, views, settings)
    shown = max_contribution(gaussians, tuple(view.to(device_of(settings.backend)) for view in views), settings.backend)
    changed = shown >= _LEAST_PIXELS
    # As many for a photo as the scene has for one of its own.
    most = len(gaussians) * len(new) // max(1, len(capture.views) - len(new))
    born, origins = born_gaussians(gaussians, views, changed, most, settings)
    begin = appended_gaussians(gaussians, born)
    weight = max(1, round((len(capture.views) - len(new)) / len(new)))
    repeated = replace(capture, views=(*capture.views, *(capture.views[number] for number in new * (weight - 1))))
    only = np.concatenate([changed, np.ones(len(born), np.bool_)])
    continued = continue_training(begin, repeated, settings, progress, checkpoint_dir, watch=watch, only=only)
    rows = np.concatenate([np.arange(len(gaussians)), origins])
    return replace(continued, origins=rows[continued.origins])


@torch.no_grad()
def born_gaussians(
    gaussians: Gaussians,
    views: Sequence[TrainingView],
    shown: NDArray[np.bool_],
    most: int,
    settings: TrainingSettings,
) -> tuple[Gaussians, NDArray[np.int64]]:
    """Gaussians where views show less than half of anything, B of them, and int64 [B]: the rows nearest to them.

    Args:
        gaussians: of the scene, G of them.
        views: that look; a later one sees what was made for an earlier one.
        shown: bool [G], rows that may be the nearest.
        most: how many are made at most.
        settings: of the run.
    """
    made = gaussians_of_rows(gaussians, np.zeros(0, np.int64))
    if not shown.any():
        return made, np.zeros(0, np.int64)
    for view in views:
        places, depths, colors = _holes(appended_gaussians(gaussians, made), view, settings)
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
    gaussians: Gaussians, view: TrainingView, settings: TrainingSettings
) -> tuple[NDArray[np.float32], NDArray[np.float64], NDArray[np.float32]]:
    """Places [B, 3] on the rays of every fourth pixel that shows nothing, their camera z [B], and the photo's colors
    there [B, 3]."""
    frame, device = view.frames[-1], device_of(settings.backend)
    camera = frame.camera
    splats = splats_of(gaussians, torch.zeros(len(gaussians), 1, device=device), device)
    rendering = rasterize(splats, view.viewmat.to(device), camera, backend=settings.backend)
    alpha = rendering.alpha.cpu().numpy()
    depth = rendering.depth.cpu().numpy() / np.maximum(alpha, 1e-6)
    there = alpha >= _SOMETHING
    nothing = ~there if frame.valid is None else ~there & frame.valid.cpu().numpy()
    if not there.any():
        nothing[:] = False
    row, column = np.nonzero(nothing)
    grid = (row % _SPACING == _SPACING // 2) & (column % _SPACING == _SPACING // 2)
    row, column = row[grid], column[grid]
    _, labels = cv2.distanceTransformWithLabels(
        (~there).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
    )
    known = np.zeros(labels.max() + 1)
    known[labels[there]] = depth[there]
    z = known[labels[row, column]]
    pose = np.linalg.inv(view.viewmat.cpu().numpy().astype(np.float64))
    local = camera.rays(column + 0.5, row + 0.5) * z[:, None]
    colors = frame.rgb.cpu().numpy()[row, column].astype(np.float32) / 255
    return (local @ pose[:3, :3].T + pose[:3, 3]).astype(np.float32), z, colors


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
