"""Trained Gaussians, measured on a capture's own images and label maps: no text encoder, no stored scene."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from benchmarks.evaluation.image_quality import psnr
from benchmarks.evaluation.metrics import Skipped, mean
from benchmarks.evaluation.segmentation import MaskCounts, mask_counts
from fastsplat.service.capture.captures import Capture
from fastsplat.service.perception.results import Labelling
from fastsplat.service.scene.artefact.scene import Gaussians, SemanticHead
from fastsplat.service.splatting.gaussians import splats_of
from fastsplat.service.splatting.raster.checks import device_of
from fastsplat.service.splatting.raster.image_formation import Backend
from fastsplat.service.splatting.raster.rendering import rasterize, sh_to_rgb
from fastsplat.service.splatting.training_views import load_views
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.geometry.camera import PosedCamera


@dataclass(frozen=True)
class ViewsReport:
    """Figures over a set of views.

    Attributes:
        psnr: dB, mean over the views where it is defined; NaN without any.
        mean_iou: over the labels present in the true maps of these views, all pixels pooled; NaN without labels.
        iou: by label name, NaN where the label is in neither.
    """

    psnr: float
    mean_iou: float
    iou: Mapping[str, float]


def evaluate_views(
    gaussians: Gaussians,
    head: SemanticHead,
    capture: Capture,
    labelling: Labelling,
    names: Collection[str],
    *,
    max_side: int = 1_000_000,
    backend: Backend = "cpu",
) -> ViewsReport:
    """Figures of the named views, rendered and compared with the capture's images and `labelling`'s maps.

    Args:
        gaussians, head: the trained scene; its classes are those of `labelling.dictionary`.
        names: image names; each must be a view of `capture`.
        max_side: images are compared at this many pixels on the longer side, the images' own size by default.

    Raises:
        InvalidInputError: a name that is no view of the capture, or a head with other classes than the dictionary.
    """
    position = {view.posed.name: index for index, view in enumerate(capture.views)}
    missing = [name for name in names if name not in position]
    if missing or not names:
        raise InvalidInputError(f"no views named {missing}" if missing else "no views to evaluate", field="names")
    labels = len(labelling.dictionary)
    if len(head.bias) != labels + 1:
        raise InvalidInputError(f"a head of {len(head.bias)} classes for {labels} labels", field="head")
    counts = MaskCounts.zeros(labels)
    ratios: list[float] = []
    for name in names:
        index = position[name]
        (view,) = load_views(capture, labelling, (index,), max_side, (1.0,))
        frame = view.frames[0]
        posed = PosedCamera(frame.camera, capture.views[index].posed.world_from_camera, name)
        rgb, predicted = render_view(gaussians, head, posed, backend=backend)
        image, target = rgb.clamp(0, 1).cpu().numpy(), frame.target().numpy()
        valid = None if frame.valid is None else frame.valid.numpy()
        if not isinstance(ratio := psnr(image, target, valid), Skipped):
            ratios.append(ratio)
        if frame.labels is not None:
            counts += mask_counts(predicted, frame.labels.numpy(), labels, valid)
    iou = counts.iou()
    return ViewsReport(
        psnr=mean(ratios),
        mean_iou=counts.macro_iou(),
        iou={entry.label: float(iou[i + 1]) for i, entry in enumerate(labelling.dictionary.entries)},
    )


@torch.no_grad()
def render_view(
    gaussians: Gaussians, head: SemanticHead, posed: PosedCamera, *, backend: Backend = "cpu"
) -> tuple[Tensor, NDArray[np.int32]]:
    """float32 [H, W, 3] colors on black, on the backend's device; int32 [H, W] most probable classes, 0 undetected."""
    device = device_of(backend)

    def there(values: NDArray[Any]) -> Tensor:
        return torch.from_numpy(np.ascontiguousarray(values, dtype=np.float32)).to(device)

    origin = there(posed.world_from_camera[:3, 3])
    colors = sh_to_rgb(there(gaussians.means), there(gaussians.sh), origin, gaussians.sh_degree, backend=backend)
    splats = splats_of(gaussians, torch.cat([colors, there(gaussians.codes)], dim=1), device=device)
    image = rasterize(splats, there(posed.camera_from_world()), posed.camera, backend=backend).image.float()
    logits = image[..., 3:] @ there(head.weight).T + there(head.bias)
    return image[..., :3], logits.argmax(dim=2).to(torch.int32).cpu().numpy()
