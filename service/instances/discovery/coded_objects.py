"""Codes of Gaussians, trained to tell their object, on all views at once.

Labels are pixels in which masks and rendered objects agree (.020 mean IoU above blended membership on the tests' table
top).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
import torch

from fastsplat.service.instances.discovery.refinement import MaskedView, repainted
from fastsplat.service.instances.discovery_settings import DiscoverySettings
from fastsplat.service.scene.artefact.scene import F32, Gaussians, Objects, SemanticHead
from fastsplat.service.scene.objects.objects import object_rows
from fastsplat.service.splatting.gaussians import splats_of
from fastsplat.service.splatting.labels.blending import EvidenceBlend
from fastsplat.service.splatting.labels.label_refit import LabeledView, codes_from_labels
from fastsplat.service.splatting.raster.checks import device_of
from fastsplat.service.splatting.raster.image_formation import Backend
from fastsplat.service.splatting.training_views import smallest_labels

_EPOCHS, _LOOKED_AT = 6, 600_000  # epochs over the views, and the limit of Gaussians times epochs
_NO_OBJECT_WEIGHT = 0.3  # weight of pixels without mask, as the segmenter may have missed an object


def fit_object_codes(
    objects: Objects,
    gaussians: Gaussians,
    views: Sequence[MaskedView],
    settings: DiscoverySettings,
    *,
    size: Literal["auto"] | int = "auto",
    seed: int = 0,
    backend: Backend = "cpu",
) -> tuple[F32, SemanticHead] | None:
    """Trains codes, float32 [G, D], and their head with class n for object id n.

    In each view rendered objects take the masks that they match (`repainted`); pixels in which the two differ are
    ignored. Returns None without objects, views or Gaussians.

    Args:
        gaussians: G of them; color and geometry are frozen.
        views: those that have masks.
        settings: for the least overlap of an object with its mask.
        size: D, see `code_size`.
    """
    classes = max((obj.id for obj in objects.table), default=0) + 1
    if classes == 1 or not views or not len(gaussians):
        return None
    device = device_of(backend)
    splats = splats_of(gaussians, device=device)
    blend = EvidenceBlend(objects.membership, classes, device)
    labeled = []
    for view in views:
        viewmat = torch.from_numpy(view.posed.camera_from_world().astype(np.float32)).to(device)
        drawn = blend.render(splats, viewmat, view.posed.camera, alpha_min=0.5, relevancy=None, backend=backend)
        object_map = drawn.classes.cpu().numpy()
        masked = repainted(object_map, view.masks(), min_overlap=settings.min_overlap)
        agreed, content = masked == object_map, view.valid()
        if content is not None:
            agreed &= content
        labels = torch.from_numpy(smallest_labels(object_map)).to(device)
        labeled.append(LabeledView(viewmat, view.posed.camera, labels, torch.from_numpy(agreed).to(device)))
    return codes_from_labels(
        gaussians,
        labeled,
        objects.membership,
        object_rows(objects),
        classes,
        size=size,
        none_weight=_NO_OBJECT_WEIGHT,
        steps=len(labeled) * max(1, min(_EPOCHS, _LOOKED_AT // len(gaussians))),
        seed=seed,
        backend=backend,
    )
