"""The training-free way to labels: one look per view at which label every Gaussian is seen through."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from fastsplat.service.common.dictionary import UNDETECTED
from fastsplat.service.scene.evidence import UNIT, evidence_of, merged, no_evidence
from fastsplat.service.scene.types import Evidence, Gaussians
from fastsplat.service.splatting.raster import Backend, LabelSums, Splats, device_of, label_sums
from fastsplat.service.splatting.views import TrainingView
from fastsplat_contract.camera import PosedCamera
from fastsplat_contract.errors import InvalidInputError


def view_evidence(
    gaussians: Gaussians,
    posed: PosedCamera,
    labels: NDArray[np.integer],
    classes: int,
    *,
    valid: NDArray[np.bool_] | None = None,
    undetected_weight: float = 1.0,
    backend: Backend = "cpu",
) -> Evidence:
    """What one view's label map says of each Gaussian: Σ_p w·1[label(p) = n], rounded to 1/4096 pixel.

    The same input gives the same integers on one kind of processor, so what was added with `merged` can be taken away
    with `without`.

    Args:
        gaussians: G of them.
        posed: the view.
        labels: int [H, W], 0..classes − 1.
        classes: N + 1.
        valid: bool [H, W]; pixels that are False say nothing, not even "undetected".
        undetected_weight: what a pixel of class 0 counts, in pixels.
        backend: which rasterizer.

    Raises:
        InvalidInputError: a map of another size than the camera's, or with a label that is not below `classes`.
    """
    if valid is not None and valid.shape != labels.shape:
        raise InvalidInputError(f"valid pixels {valid.shape} for labels {labels.shape}", field="valid")
    image = labels.astype(np.int32)
    if valid is not None:
        image[~valid] = -1
    viewmat = torch.from_numpy(posed.camera_from_world().astype(np.float32))
    sums = label_sums(
        activated(gaussians, backend), viewmat, posed.camera, torch.from_numpy(image), classes, backend=backend
    )
    rows = np.repeat(np.arange(len(gaussians)), np.diff(sums.starts.cpu().numpy()))
    names = sums.labels.cpu().numpy()
    pixels = sums.sums.cpu().numpy() * np.where(names == UNDETECTED, undetected_weight, 1.0)
    return evidence_of(rows, names, np.rint(pixels * UNIT).astype(np.int64), len(gaussians))


def views_evidence(
    gaussians: Gaussians,
    views: Sequence[TrainingView],
    classes: int,
    *,
    undetected_weight: float = 1.0,
    backend: Backend = "cpu",
) -> Evidence:
    """The evidence of all views that have a label map, at their training size.

    Args:
        gaussians: G of them.
        views: training views; what is held out must not be among them.
        classes: N + 1.
        undetected_weight: what a pixel of class 0 counts, in pixels.
        backend: which rasterizer.
    """
    parts = [no_evidence(len(gaussians))]
    for view in views:
        frame = view.frames[-1]
        if frame.labels is not None:
            world_from_camera = np.linalg.inv(view.viewmat.cpu().numpy().astype(np.float64))
            posed = PosedCamera(frame.camera, world_from_camera, view.name)
            valid = None if frame.valid is None else frame.valid.cpu().numpy()
            parts.append(
                view_evidence(
                    gaussians,
                    posed,
                    frame.labels.cpu().numpy(),
                    classes,
                    valid=valid,
                    undetected_weight=undetected_weight,
                    backend=backend,
                )
            )
    return merged(parts)


def region_sums(splats: Splats, view: TrainingView, ids: NDArray[np.integer], backend: Backend) -> LabelSums:
    """The weight of each Gaussian by id, on the CPU; ids int [H, W] at the view's training size, 0 = no region. Pixels
    that are not valid count for nothing."""
    frame, device = view.frames[-1], splats.means.device
    image = torch.from_numpy(ids.astype(np.int32)).to(device)
    if frame.valid is not None:
        image[~frame.valid.to(device)] = -1
    bound = int(ids.max(initial=0)) + 1
    sums = label_sums(splats, view.viewmat.to(device), frame.camera, image, bound, backend=backend)
    return LabelSums(sums.starts.cpu(), sums.labels.cpu(), sums.sums.cpu())


def activated(gaussians: Gaussians, backend: Backend) -> Splats:
    """The Gaussians as the rasterizer wants them, without features."""
    device = device_of(backend)

    def tensor(array: NDArray[np.float32]) -> torch.Tensor:
        return torch.tensor(np.asarray(array), dtype=torch.float32, device=device)

    return Splats(
        tensor(gaussians.means),
        tensor(gaussians.quats),
        tensor(gaussians.log_scales).exp_(),
        tensor(gaussians.logit_opacities).sigmoid_(),
        torch.zeros(len(gaussians), 0, device=device),
    )
