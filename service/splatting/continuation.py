"""Training that goes on from a finished scene: its Gaussians, their fate, and schedules for what is nearly right.

A run's last state is not kept with its scene: 12 bytes a parameter for Adam's moments alone. They are made anew in the
first tenth of the run, in which learning rates rise from 0. Opacities are not set back, all harmonics are in use from
the first step, pictures have their full size, and the means begin with the rate that is, geometrically, in the middle
of what they begin and end with in a new run.

Labels are not trained: each Gaussian carries the number of the row that it comes from as its only code, copies carry
that of the Gaussian that they are copies of, and what that one belonged to, they belong to.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.capture.types import Capture
from fastsplat.service.common.dictionary import Dictionary
from fastsplat.service.common.progress import Progress
from fastsplat.service.perception.types import Labelling
from fastsplat.service.scene.types import SH_COUNTS, Gaussians
from fastsplat.service.splatting.previews import UNWATCHED, TrainingWatch
from fastsplat.service.splatting.settings import TrainingSettings
from fastsplat.service.splatting.train import train
from fastsplat.service.splatting.types import TrainedSplats
from fastsplat_contract.errors import LimitExceededError

_WARMUP = 0.1
_LEAST_WARMUP = 30
"""Steps: Adam's second moments are of any use after so many."""
_RATES = 0.5
_GROW_UNTIL = 0.5
_MOST_ROWS = 1 << 24
"""Larger row numbers are not exact in float32."""


@dataclass(frozen=True)
class Continued:
    """A scene that was trained further.

    Attributes:
        trained: its Gaussians, whose codes mean nothing, and figures of the run; those of before end in `_before`.
        origins: int64 [G]: the row of the scene before that each comes from.
        changed: bool [G]: which were trained, where only some were: the others are those of before, to the bit, and all
            rows of before come first; None where all were.
    """

    trained: TrainedSplats
    origins: NDArray[np.int64]
    changed: NDArray[np.bool_] | None = None


def continuation_settings(
    settings: TrainingSettings,
    gaussians: Gaussians,
    *,
    seconds: float | None = None,
    steps: int | None = None,
    hold_out: bool = True,
) -> TrainingSettings:
    """The settings of a run that goes on from some Gaussians.

    Args:
        settings: of a new run, with the preset applied.
        gaussians: that it goes on from.
        seconds: of optimization.
        steps: of optimization instead; with neither the settings' own bounds.
        hold_out: whether views are held out from it.
    """
    rates = settings.rates
    warmup = _WARMUP
    if steps is not None:
        warmup = min(max(warmup, _LEAST_WARMUP / steps), 0.9)
        settings = settings.model_copy(update={"iterations": steps, "time_budget_s": None})
    elif seconds is not None:
        settings = settings.ending_after(seconds)
    return settings.model_copy(
        update={
            "max_gaussians": max(settings.max_gaussians, len(gaussians)),
            "max_sh_degree": max(settings.max_sh_degree, gaussians.sh_degree),
            "sh_from": (0.0, 0.0, 0.0),
            "start_scale": 1.0,
            "full_size_from": 0.0,
            "depth_from": 0.0,
            "warmup": warmup,
            "densify_from": warmup,
            "densify_until": _GROW_UNTIL,
            "full_count_at": _GROW_UNTIL,
            "held_out_every": settings.held_out_every if hold_out else 0,
            "max_psnr_drop_db": 0.0,
            "rates": rates.model_copy(
                update={
                    "means": math.sqrt(rates.means * rates.means_final),
                    "quats": _RATES * rates.quats,
                    "log_scales": _RATES * rates.log_scales,
                    "logit_opacities": _RATES * rates.logit_opacities,
                    "sh_dc": _RATES * rates.sh_dc,
                }
            ),
        }
    )


def continue_training(
    gaussians: Gaussians,
    capture: Capture,
    settings: TrainingSettings,
    progress: Progress,
    checkpoint_dir: Path | None = None,
    *,
    watch: TrainingWatch = UNWATCHED,
    only: NDArray[np.bool_] | None = None,
) -> Continued:
    """The scene after more training, see `train`; nothing is trained but color and geometry.

    Args:
        gaussians: of the scene, G of them, in the capture's frame.
        capture: the photos that are kept with the scene.
        settings: see `continuation_settings`.
        progress, checkpoint_dir, watch, only: as for `train`.

    Raises:
        LimitExceededError: more than 2²⁴ Gaussians.
        FastSplatError: as `train`.
    """
    count = len(gaussians)
    if count > _MOST_ROWS:
        raise LimitExceededError(f"{count} Gaussians", field="scene", limit=f"{_MOST_ROWS} Gaussians")
    harmonics = np.zeros((count, SH_COUNTS[settings.max_sh_degree], 3), np.float32)
    harmonics[:, : gaussians.sh.shape[1]] = gaussians.sh
    begin = replace(
        gaussians,
        means=gaussians.means.copy(),
        quats=gaussians.quats.copy(),
        log_scales=gaussians.log_scales.copy(),
        logit_opacities=gaussians.logit_opacities.copy(),
        sh=harmonics,
        codes=np.arange(count, dtype=np.float32)[:, None],
    )
    unlabeled = Labelling(Dictionary(()), ())
    trained = train(capture, unlabeled, settings, progress, checkpoint_dir, watch=watch, begin=begin, only=only)
    return Continued(trained, np.rint(trained.gaussians.codes[:, 0]).astype(np.int64), only)
