"""What the splatting room hands on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from service.scene.types import Gaussians, SemanticHead


@dataclass(frozen=True)
class TrainedSplats:
    """The result of the paper's single phase.

    Attributes:
        gaussians: in Morton order of their means; the order is final.
        head: the affine map W that was trained with the codes.
        quality: psnr, ssim (means over held-out views), held_out (count), iterations, gaussians, ...
        held_out: names of the views that never entered a loss.
    """

    gaussians: Gaussians
    head: SemanticHead
    quality: Mapping[str, float]
    held_out: tuple[str, ...]
