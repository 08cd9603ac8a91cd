"""Codes of things: each Gaussian's code learns which thing it is, from maps of things that mask and scene agree on,
fitted to all views at once (mean IoU .020 above blended membership on the tests' table top)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
import torch

from fastsplat.service.instances.refinement import MaskedView, repainted
from fastsplat.service.instances.settings import DiscoverySettings
from fastsplat.service.scene.label_evidence import seen_pixels
from fastsplat.service.scene.things import thing_rows
from fastsplat.service.scene.types import F32, Gaussians, SemanticHead, Things
from fastsplat.service.splatting.blending import EvidenceBlend
from fastsplat.service.splatting.gaussians import splats_of
from fastsplat.service.splatting.label_refit import LabeledView, fit_codes
from fastsplat.service.splatting.raster.checks import device_of
from fastsplat.service.splatting.raster.types import Backend
from fastsplat.service.splatting.semantics import class_weights, code_size, separated_codes, start_head
from fastsplat.service.splatting.training_views import smallest_labels

_EPOCHS, _LOOKED_AT = 6, 600_000
"""Looks at every view; fewer where a look is dear: so many Gaussians are drawn once."""
_NO_THING_WEIGHT = 0.3
"""Of a pixel that no mask claims: it may be of a thing that the segmenter missed."""


def fit_thing_codes(
    things: Things,
    gaussians: Gaussians,
    views: Sequence[MaskedView],
    settings: DiscoverySettings,
    *,
    size: Literal["auto"] | int = "auto",
    seed: int = 0,
    backend: Backend = "cpu",
) -> tuple[F32, SemanticHead] | None:
    """Codes, float32 [G, D], and the head whose class n is the thing with the id n; None without things or masks.

    In every view things are drawn by their membership and take the masks that they match (`repainted`); pixels in which
    the two differ, where views disagree, say nothing.

    Args:
        gaussians: G of them; their color and geometry are held.
        views: those that have masks.
        settings: the least overlap of a thing with its mask.
        size: D, see `code_size`.
        seed: of the order of views.
    """
    classes = max((thing.id for thing in things.table), default=0) + 1
    if classes == 1 or not views or not len(gaussians):
        return None
    device = device_of(backend)
    splats = splats_of(gaussians, device=device)
    blend = EvidenceBlend(things.membership, classes, device)
    labeled = []
    for view in views:
        viewmat = torch.from_numpy(view.posed.camera_from_world().astype(np.float32)).to(device)
        drawn = blend.render(splats, viewmat, view.posed.camera, alpha_min=0.5, relevancy=None, backend=backend)
        shown = drawn.classes.cpu().numpy()
        masked = repainted(shown, view.masks(), min_overlap=settings.min_overlap)
        agreed, content = masked == shown, view.valid()
        if content is not None:
            agreed &= content
        labels = torch.from_numpy(smallest_labels(shown)).to(device)
        labeled.append(LabeledView(viewmat, view.posed.camera, labels, torch.from_numpy(agreed).to(device)))
    class_codes = separated_codes(classes, code_size(classes - 1, size), seed)
    owner = torch.from_numpy(thing_rows(things).astype(np.int64))
    weight, bias = start_head(class_codes)
    starts = {"codes": class_codes[owner], "weight": weight, "bias": bias}
    fitted = fit_codes(
        splats,
        labeled,
        {name: value.to(device) for name, value in starts.items()},
        owner.to(device),
        torch.from_numpy(seen_pixels(things.membership)).to(device),
        class_weights(classes, _NO_THING_WEIGHT).to(device),
        steps=len(labeled) * max(1, min(_EPOCHS, _LOOKED_AT // len(gaussians))),
        seed=seed,
        backend=backend,
    )
    arrays = {name: value.cpu().numpy() for name, value in fitted.items()}
    return arrays["codes"], SemanticHead(arrays["weight"], arrays["bias"])
