"""Results and errors of training."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from fastsplat.service.scene.types import Evidence, Gaussians, SemanticHead


@dataclass(frozen=True)
class TrainedSplats:
    """A trained scene.

    Attributes:
        gaussians: in Morton order of their means; the order is final.
        head: the affine map W that was trained with the codes.
        quality: finite figures: psnr, psnr_cc (after a correction of the colors), ssim (means over the held-out
            views that have them; absent where none has),
            held_out (count), loss (mean of the last 50 steps), iterations, gaussians, pruned_gaussians (left out
            because held-out views hardly miss them), sh_degree, train_seconds, time_budget_s, ghost_share,
            evidence_seconds, label_refit_seconds (of the labels' last fit), preview_seconds (of train_seconds, if it
            was watched), stopped_at_share (0..1 of the planned run, only if it was ended early), random_points
            (Gaussians that started at random places because the capture has too few points), exposure_ev (of a scene
            whose photos were corrected: of its colors against the photos' mean exposure, EV, at most 0).
        held_out: names of the views that never entered a loss.
        evidence: what the label maps of the other views say of each Gaussian, or None where the codes say it.
        photometric: exposure, white balance of red and of blue of each training photo by its name, EV, of mean zero
            (see `service.splatting.photometric`); empty where photos were not corrected.
        warnings: what a person should know of the run, in sentences.
    """

    gaussians: Gaussians
    head: SemanticHead
    quality: Mapping[str, float]
    held_out: tuple[str, ...]
    evidence: Evidence | None = None
    photometric: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
