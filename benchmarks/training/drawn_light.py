"""The photos of a capture in light that was drawn for each, as a camera takes them that sets its own exposure."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from fastsplat.service.capture.captures import Capture
from fastsplat.service.capture.formats.image_io import load_rgb
from fastsplat.service.splatting.exposure.photometric import correct, zero_mean

_EXPOSURE_EV, _BALANCE = 1.2, 0.06


def in_drawn_light(capture: Capture, seed: int, folder: Path) -> Capture:
    """The capture with new training photos in `folder`: exposures of ± 1.2 EV and gains of red and blue of ± 6 %, drawn
    uniformly, of linear light, with a mean of zero EV. The views that `test_names` names stay as they are."""
    rows = [row for row, view in enumerate(capture.views) if view.posed.name not in capture.test_names]
    random = np.random.default_rng(seed)
    exposures = random.uniform(-_EXPOSURE_EV, _EXPOSURE_EV, (len(rows), 1))
    balances = np.log2(1 + random.uniform(-_BALANCE, _BALANCE, (len(rows), 2)))
    views = list(capture.views)
    for row, gains in zip(rows, zero_mean(torch.tensor(np.hstack([exposures, balances]))), strict=True):
        pixels = correct(torch.tensor(load_rgb(views[row].image_path)).double() / 255, gains).clamp(0, 1)
        path = folder / f"{row:04d}.png"
        Image.fromarray((pixels * 255).round().byte().numpy()).save(path)
        views[row] = replace(views[row], image_path=path)
    return replace(capture, views=tuple(views))
