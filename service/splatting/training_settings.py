"""How a scene is trained: settings, and the options that are none."""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

from pydantic import Field

from fastsplat.service.common.setting_groups import Options, SettingGroup
from fastsplat.service.common.sh_degree import MAX_SH_DEGREE

FEWEST_STEPS = 250
"""Steps before which nobody ends a run, neither a time that was asked for nor a person: fewer leave a blur."""
MOST_STEPS = 30_000
"""Steps of a run whose seconds are given; 3DGS takes as many."""
GAIN_OF_DOUBLING = 600.0
"""Twice the steps n of a run gain about this / n dB of held-out PSNR (three captures, `docs/method.md`)."""


class LearningRates(Options):
    """Adam's learning rates at the start of a run; each decays exponentially to `final_share` of it (means:
    `means_final`).

    Larger than 3DGS's, whose runs are ten times as long: after 1,500 steps of a table scene 29.4 dB against 27.4.
    """

    means: float = Field(3e-3, gt=0)
    """Of positions, times the scene's extent."""
    means_final: float = Field(1e-5, gt=0)
    """`means` at the end of the run."""
    quats: float = Field(3e-3, gt=0)
    """Of rotations."""
    log_scales: float = Field(3e-2, gt=0)
    """Of the logarithms of the standard deviations."""
    logit_opacities: float = Field(1e-1, gt=0)
    """Of opacities before the logistic function."""
    sh_dc: float = Field(5e-3, gt=0)
    """Of the constant color."""
    sh_rest_share: float = Field(0.4, gt=0, le=1)
    """Of the other harmonics, as a share of `sh_dc`. 3DGS's 0.05 leaves highlights to geometry (`docs/method.md`)."""
    codes: float = Field(1e-2, gt=0)
    """Of the semantic codes."""
    weight: float = Field(5e-3, gt=0)
    """Of the semantic head's weight and bias."""
    photometric: float = Field(5e-3, gt=0)
    """Of the photos' exposures and white balances, EV a step of the photo."""
    photometric_final: float = Field(5e-4, gt=0)
    """`photometric` at the end of the run."""
    final_share: float = Field(0.3, gt=0, le=1)
    """What is left of every rate at the end of the run, but of those that have a final one of their own."""

    def photometric_at(self, progress: float) -> float:
        """The rate of the photos' corrections at a progress 0..1 of the run."""
        return self.photometric * math.pow(self.photometric_final / self.photometric, progress)


class TrainingOptions(Options):
    """Schedule, weights of the loss and densification."""

    seed: int = Field(0, ge=0)
    """Of every random choice."""
    min_iterations: int = Field(1_000, ge=0)
    """Steps before which the clock does not end a run: what the verdict "good" needs (`assessment`)."""
    start_scale: float = Field(0.5, gt=0, le=1)
    """Image size at the start of the run, as a share of the training size."""
    full_size_from: float = Field(0.3, ge=0, le=1)
    """Progress from which images have the training size."""
    sh_from: Annotated[tuple[float, ...], Field(min_length=MAX_SH_DEGREE, max_length=MAX_SH_DEGREE)] = (0.15, 0.4, 0.6)
    """Progress at which degrees 1, 2 and 3 come in."""
    held_out_every: int = Field(8, ge=0)
    """One view in so many is held out from training to measure quality; 0 holds none out. With fewer than 4 views none
    is: the scene needs them all. Where a capture sets views apart for testing, those are held out."""
    ssim_weight: float = Field(0.2, ge=0, le=1)
    """λ of (1 − λ) L1 + λ (1 − SSIM)."""
    semantic_weight: float = Field(0.03, ge=0)
    """Factor of the weighted cross-entropy; a larger one costs color."""
    semantic_every: int = Field(2, ge=1)
    """The cross-entropy enters every so many-th step, with so many times the weight; in the others the terms of the
    depth do (`depth_every`)."""
    undetected_weight: float = Field(0.1, ge=0, le=1)
    """What an undetected pixel weighs, in the cross-entropy and as evidence, where a labeled one has 1. In label maps
    that came with the capture a pixel without a label is as sure as any and weighs 1."""
    label_refit_epochs: int = Field(4, ge=0)
    """How often every view is looked at when codes are fitted to exact label maps (`label_refit`)."""
    code_size: Literal["auto"] | Annotated[int, Field(ge=1, le=256)] = "auto"
    """Numbers of a Gaussian's semantic code; "auto" takes it from the number of labels."""
    densify_from: float = Field(0.03, ge=0, le=1)
    """Progress at which Gaussians start to be relocated and added."""
    densify_until: float = Field(0.8, ge=0, le=1)
    """Progress from which none is relocated or added any more."""
    full_count_at: float = Field(0.5, ge=0, le=1)
    """Progress at which the budget of Gaussians is used up."""
    densify_events: int = Field(100, ge=0)
    """Relocations in a whole run."""
    cull_opacity: float = Field(0.005, ge=0, lt=1)
    """A Gaussian less opaque than this is not stored."""
    depth_spread_weight: float = Field(0.1, ge=0)
    """Weight of the spread of a pixel's depths, in squared shares (`depth_regularization`)."""
    depth_smoothness_weight: float = Field(0.3, ge=0)
    """Weight of the bend of surfaces where the photo has no edge."""
    depth_anchor_weight: float = Field(0.3, ge=0)
    """Weight of the distance of the capture's points from the surface, in shares of their depth."""
    sensor_depth_weight: float = Field(1.0, ge=0)
    """Weight of the distance of the surface from what a depth sensor measured, as a natural logarithm of their ratio,
    where a capture has such measurements."""
    depth_from: float = Field(0.1, ge=0, le=1)
    """Progress from which the terms of the depth enter the loss."""
    depth_every: int = Field(2, ge=1)
    """They enter every so many-th step, with so many times the weight."""
    evaluations: int = Field(10, ge=0)
    """How often in a run the held-out views are measured for the progress report."""
    rates: LearningRates = LearningRates()
    """Learning rates."""
    tolerance_db: float = Field(0.3, ge=0)
    """PSNR of held-out views, dB, that twice the steps may still gain. A sixth of it may be lost with Gaussians
    that are surplus, or a run's end that is (`requirement`). 0: the whole budget is spent."""
    checkpoint_every_s: float = Field(30.0, ge=0)
    """Seconds between checkpoints."""


class TrainingSettings(TrainingOptions, SettingGroup, section="training"):
    """How long, how large and how fine a scene is trained.

    A run ends at `iterations` or after `time_budget_s` seconds, but the clock ends none before `min_iterations` (see
    `ending_after`). Schedules are functions of its progress, 0 to 1; a run bounded by iterations alone
    (`time_budget_s=None`) is reproducible to the bit.
    """

    backend: Literal["cpu", "cuda", "reference"] = "cpu"
    """Which rasterizer."""
    max_gaussians: int = Field(40_000, ge=1)
    """Hard budget, never exceeded at any moment."""
    time_budget_s: float | None = Field(120.0, gt=0)
    """Seconds of optimization, or None for no bound."""
    iterations: int = Field(2_000, ge=1)
    """Bound on optimization steps."""
    max_side: int = Field(640, ge=8)
    """Images are trained at no more than this many pixels on the longer side."""
    max_sh_degree: int = Field(3, ge=0, le=MAX_SH_DEGREE)
    """Degree of the color's spherical harmonics at the end of the run, 0 to 3."""
    photometric: Literal["auto", "on", "off"] = "auto"
    """Whether exposure and white balance of every photo are found along with the scene."""
    label_mode: Literal["codes", "evidence", "auto"] = "auto"
    """Where the scene keeps its labels. codes: trained jointly with color and geometry. evidence: projected once from
    the label maps. auto: codes."""

    def ending_after(self, seconds: float) -> Self:
        """These settings for a run that ends after so many seconds, or `FEWEST_STEPS` if those take longer."""
        fewest = min(self.min_iterations, FEWEST_STEPS)
        return self.model_copy(update={"time_budget_s": seconds, "min_iterations": fewest})
