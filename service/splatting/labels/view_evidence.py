"""Computes label evidence by projecting label maps onto Gaussians, without training."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fastsplat.service.common.dictionary import UNDETECTED
from fastsplat.service.scene.artefact.scene import Evidence, Gaussians
from fastsplat.service.scene.objects.label_evidence import UNIT, evidence_of, merged, no_evidence
from fastsplat.service.splatting.gaussians import splats_of
from fastsplat.service.splatting.raster.checks import device_of
from fastsplat.service.splatting.raster.image_formation import Backend, Splats
from fastsplat.service.splatting.raster.rendering import label_sums
from fastsplat.service.splatting.training_views import TrainingView
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.geometry.camera import Camera, PosedCamera

_PENDING_ENTRIES = 1 << 21  # merging takes about 50 bytes an entry beside the result


def view_evidence(
    gaussians: Gaussians,
    posed: PosedCamera,
    labels: NDArray[np.integer],  # [H, W], 0..classes − 1
    classes: int,  # N + 1
    *,
    valid: NDArray[np.bool_] | None = None,  # bool [H, W]; invalid pixels do not count, not even as undetected
    undetected_weight: float = 1.0,  # weight of class-0 pixels
    backend: Backend = "cpu",
) -> Evidence:
    """Computes a view's evidence Σ_p w·1[label(p) = n], rounded to 1/4096 pixel.

    Raises:
        InvalidInputError: a map that differs in size from the camera, or a label from `classes` up.
    """
    if valid is not None and valid.shape != labels.shape:
        raise InvalidInputError(f"valid pixels {valid.shape} for labels {labels.shape}", field="valid")
    splats = splats_of(gaussians, device=device_of(backend))
    viewmat = torch.from_numpy(posed.camera_from_world().astype(np.float32))
    return _evidence(splats, viewmat, posed.camera, labels, classes, valid, undetected_weight, backend)


def views_evidence(
    gaussians: Gaussians,
    views: Sequence[TrainingView],  # without held-out ones
    classes: int,  # N + 1
    *,
    undetected_weight: float = 1.0,  # weight of class-0 pixels
    backend: Backend = "cpu",
) -> Evidence:
    """Merges the evidence of all views with label maps, at their training size."""
    splats = splats_of(gaussians, device=device_of(backend))
    parts = [no_evidence(len(gaussians))]
    for view in views:
        frame = view.frames[-1]
        if frame.labels is None:
            continue
        valid = None if frame.valid is None else frame.valid.cpu().numpy()
        labels = frame.labels.cpu().numpy()
        parts.append(_evidence(splats, view.viewmat, frame.camera, labels, classes, valid, undetected_weight, backend))
        if sum(len(part.labels) for part in parts[1:]) > _PENDING_ENTRIES:
            parts = [merged(parts)]
    return merged(parts)


def _evidence(
    splats: Splats,
    viewmat: Tensor,
    camera: Camera,
    labels: NDArray[np.integer],
    classes: int,
    valid: NDArray[np.bool_] | None,
    undetected_weight: float,
    backend: Backend,
) -> Evidence:
    count = len(splats.means)
    image = labels.astype(np.int32)
    if valid is not None:
        image[~valid] = -1
    sums = label_sums(splats, viewmat, camera, torch.from_numpy(image), classes, backend=backend)
    rows = np.repeat(np.arange(count), np.diff(sums.starts.cpu().numpy()))
    names = sums.labels.cpu().numpy()
    pixels = sums.sums.cpu().numpy() * np.where(names == UNDETECTED, undetected_weight, 1.0)
    return evidence_of(rows, names, np.rint(pixels * UNIT).astype(np.int64), count)
