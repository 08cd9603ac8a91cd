"""Results of training."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from fastsplat.service.scene.artefact.scene import Evidence, Gaussians, SemanticHead


@dataclass(frozen=True)
class TrainedSplats:
    """A trained scene.

    Attributes:
        head: affine map W trained with the codes.
        quality: finite figures: psnr, psnr_cc (after color correction), ssim (means over held-out views that have them;
            otherwise absent), held_out (count), loss (mean of the last 50 steps), iterations, gaussians,
            sh_degree, train_seconds, time_budget_s, ghost_share, evidence_seconds,
            label_refit_seconds, preview_seconds (part of train_seconds), stopped_at_share (0..1 of the planned run,
            only if ended early), tolerance_db, enough (1 if more steps were not required), next_doubling_db (PSNR
            that twice the steps would about gain), random_points (initial Gaussians at random
            places for lack of capture points),
            exposure_ev (colors against the photos' mean exposure, EV, at most 0, only with photometric correction).
        held_out: names of views that never entered a loss.
        evidence: label evidence of the other views; None if codes store the labels.
        photometric: exposure, red and blue white balance by training photo, EV, zero mean
            (`service.splatting.exposure.photometric`); empty without correction.
        warnings: sentences that say what a person should know of the run.
    """

    gaussians: Gaussians
    head: SemanticHead
    quality: Mapping[str, float]
    held_out: tuple[str, ...]
    evidence: Evidence | None = None
    photometric: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
