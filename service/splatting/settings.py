"""Choices of the training room."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field


class LearningRates(BaseModel):
    """Adam step sizes at the start of a run; each decays exponentially to `final_share` of it (means: `means_final`).

    Larger than 3DGS's, whose runs are ten times as long. Measured once each on held-out views after 1,500 steps with
    12,000 Gaussians at 240×180: these 29.4 dB on a table scene and 27.1 on the demo's sample, 3DGS's 27.4 and 23.8;
    another seed moves that by 0.1 to 0.3 dB.

    Attributes:
        means: times the scene's extent, scene units a step.
        means_final: `means` at the end of the run.
        sh_dc: constant colour; the other harmonics move `sh_rest_share` as fast.
        weight: the semantic head's weight and bias.
    """

    model_config = ConfigDict(frozen=True)

    means: float = Field(3e-3, gt=0)
    means_final: float = Field(1e-5, gt=0)
    quats: float = Field(3e-3, gt=0)
    log_scales: float = Field(3e-2, gt=0)
    logit_opacities: float = Field(1e-1, gt=0)
    sh_dc: float = Field(5e-3, gt=0)
    sh_rest_share: float = Field(0.05, gt=0, le=1)
    codes: float = Field(1e-2, gt=0)
    weight: float = Field(5e-3, gt=0)
    final_share: float = Field(0.3, gt=0, le=1)


class TrainingSettings(BaseModel):
    """How long, how large and how fine a scene is trained.

    A run ends at `iterations` or after `time_budget_s` seconds, whichever is first, and every schedule below is a
    function of the share of the run that is over; so a run bounded by iterations alone (`time_budget_s=None`) is
    reproducible to the bit, and one bounded by time adapts to the machine it is on.

    Attributes:
        backend: which rasterizer.
        seed: of every random choice.
        max_gaussians: hard budget, never exceeded at any moment.
        time_budget_s: seconds of optimisation, or None for no bound.
        iterations: bound on optimisation steps.
        max_side: images are trained at no more than this many pixels on the longer side.
        start_scale: image size at the start of the run, as a share of the training size.
        full_size_from: share of the run from which images have the training size.
        max_sh_degree: spherical harmonics of the colour, 0..3.
        sh_from: share of the run at which degrees 1, 2 and 3 come in.
        held_out_every: one view in so many is kept from training to measure quality; 0 keeps none. With fewer than 4
            views none is kept: the scene needs them all. A capture that sets views apart for testing keeps those.
        ssim_weight: λ of (1 − λ) L1 + λ (1 − SSIM).
        semantic_weight: factor of the weighted cross-entropy; a larger one costs colour.
        semantic_every: the cross-entropy enters every so many-th step.
        label_mode: where the scene keeps its labels. codes: trained jointly with colour and geometry. evidence: colour
            and geometry are trained alone, then comes one look at the label maps. auto: codes, which with exact label
            maps have a mean IoU of 0.975 where evidence has 0.892 (`benchmarks/semantics`).
        undetected_weight: what an undetected pixel weighs, in the cross-entropy and as evidence, where a labelled one
            has 1. In label maps that came with the capture a pixel without a label is as sure as any and weighs 1.
        vote_at: share of a run at which the views agree on what was detected (`service.splatting.consensus`). Before it
            colour and geometry are trained alone, after it codes as well; label maps that came with the capture need
            no vote.
        agreed_undetected_weight: as `undetected_weight`, once the views have agreed: what all of them missed is then
            likelier to be nothing.
        code_size: numbers a Gaussian carries for its meaning; "auto" takes it from the number of labels.
        background: what shines through the scene in training: black, or a random colour a step, which leaves no holes.
        densify_from: share of the run at which Gaussians start to be relocated and added.
        densify_until: share of the run at which their number and places are final.
        full_count_at: share of the run at which the budget is used up.
        densify_events: relocations in a whole run.
        dead_opacity: a Gaussian below this is moved to where it is needed.
        cull_opacity: a Gaussian below this is not stored.
        surplus_loss_db: what the finished scene may lose on its held-out views by leaving out harmonics and Gaussians
            that hardly matter, dB; 0 keeps everything, and so does a run without held-out views.
        opacity_decay: weight of the mean opacity in the loss (3DGS-MCMC), so that useless Gaussians die.
        scale_decay: weight of the mean scale, in shares of the scene's extent, in the loss.
        evaluations: how often in a run the held-out views are measured for the progress report.
        checkpoint_every_s: seconds between checkpoints.
    """

    model_config = ConfigDict(frozen=True)

    backend: Literal["cpu", "cuda", "reference"] = "cpu"
    seed: int = Field(0, ge=0)
    max_gaussians: int = Field(40_000, ge=1)
    time_budget_s: float | None = Field(120.0, gt=0)
    iterations: int = Field(30_000, ge=1)
    max_side: int = Field(640, ge=8)
    start_scale: float = Field(0.5, gt=0, le=1)
    full_size_from: float = Field(0.3, ge=0, le=1)
    max_sh_degree: int = Field(1, ge=0, le=3)
    sh_from: tuple[float, float, float] = (0.15, 0.4, 0.6)
    held_out_every: int = Field(8, ge=0)
    ssim_weight: float = Field(0.2, ge=0, le=1)
    semantic_weight: float = Field(0.03, ge=0)
    semantic_every: int = Field(1, ge=1)
    label_mode: Literal["codes", "evidence", "auto"] = "auto"
    undetected_weight: float = Field(0.1, ge=0, le=1)
    vote_at: float = Field(0.5, ge=0, le=1)
    agreed_undetected_weight: float = Field(0.3, ge=0, le=1)
    code_size: Literal["auto"] | Annotated[int, Field(ge=1, le=256)] = "auto"
    background: Literal["black", "random"] = "black"
    densify_from: float = Field(0.03, ge=0, le=1)
    densify_until: float = Field(0.8, ge=0, le=1)
    full_count_at: float = Field(0.5, ge=0, le=1)
    densify_events: int = Field(100, ge=0)
    dead_opacity: float = Field(0.005, ge=0, lt=1)
    cull_opacity: float = Field(0.005, ge=0, lt=1)
    surplus_loss_db: float = Field(0.0, ge=0)
    opacity_decay: float = Field(0.02, ge=0)
    scale_decay: float = Field(0.01, ge=0)
    evaluations: int = Field(10, ge=0)
    checkpoint_every_s: float = Field(30.0, ge=0)
    rates: LearningRates = LearningRates()
