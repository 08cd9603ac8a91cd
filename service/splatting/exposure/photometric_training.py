"""When and how a run corrects its photos' exposure and white balance (`photometric`).

Photos that agree are better left alone: three free numbers each cost 0.2 to 0.4 dB. A run that is left to photos that
differ may explain each by Gaussians before its own camera. So with `photometric = "auto"` it looks at its photos after
so many steps, whatever the time: it notes each photo's fit to its rendered picture, corrects the photos where they
differ or their EXIF says so, looks again where it is in doubt, and drops corrections that turn out small. A correction
follows the fit of the median, which draws it near in a few visits, and the gradient.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from fastsplat.service.splatting.exposure.photometric import fitted_correction, zero_mean
from fastsplat.service.splatting.optim import adam_update
from fastsplat.service.splatting.raster.image_formation import Rendering
from fastsplat.service.splatting.state import SplatState
from fastsplat.service.splatting.training_settings import TrainingSettings
from fastsplat.service.splatting.training_views import Frame, TrainingView

_PHOTOMETRIC_FIT_UNTIL = 0.7
"""Progress until which a photo's correction is drawn to the one by which it fits the picture in the median; the
gradient of the loss refines it all along."""

CORRECTIONS = "photometric"
"""Name of the corrections [V, 3] among the parameters of a run: exposure, red, blue of each training view, EV."""
FITS = "photometric_fits"
"""Name of what was noted of photos that are not corrected so far [V, 4]: their fits, and how many there were."""
STEPS = "photometric_steps"
"""Name of how many steps of Adam each correction has had [V]; corrections may begin late in a run."""

_WARM_UP = 50
"""Steps before which pictures say too little of the photos."""
_LOOKS, _VISITS, _FEWEST_STEPS, _MOST_STEPS = 5, 2, 50, 200
"""Looks at the photos in a run; each comes after so many more visits of each photo, within these bounds of steps."""
_EXPOSURE_SPREAD, _BALANCE_SPREAD = 0.12, 0.08
"""Standard deviations over the photos, EV, from which they are taken to differ."""
_BEGUN_AT_FIRST, _BEGUN, _DROP_BELOW = 2.0, 1.25, 1.0
"""In times these. At the first look, of crude pictures, corrections begin above the first; later ones begin them above
the second and drop those below the third."""
_FIT_SHARE = 0.5
"""How far a fit draws a correction towards itself."""


def start_corrections(views: Sequence[TrainingView], settings: TrainingSettings) -> dict[str, Tensor]:
    """What a new run's parameters hold of its photos' corrections; they start at what EXIF says of the exposures, or at
    zero where a photo says nothing."""
    if settings.photometric == "off" or len(views) < 2:
        return {}
    exposures = torch.tensor([math.nan if view.exposure_ev is None else view.exposure_ev for view in views])
    corrections = torch.zeros(len(views), 3)
    corrections[:, 0] = (exposures - exposures.nanmean()).nan_to_num()
    corrections = zero_mean(corrections)
    if settings.photometric == "on" or _spread(corrections) > _DROP_BELOW:
        return {CORRECTIONS: corrections}
    return {FITS: torch.zeros(len(views), 4)}


class PhotometricTraining:
    """The corrections of a run; everything it knows is in the run's state, so that a checkpoint holds it."""

    def __init__(self, settings: TrainingSettings) -> None:
        self._settings = settings

    def decide_if_due(self, state: SplatState) -> None:
        """Begins or drops the corrections of a run that decides by itself, if the photos are to be looked at now."""
        known = state.parameters.get(CORRECTIONS, state.parameters.get(FITS))
        if known is None or self._settings.photometric != "auto":
            return
        gap = min(max(_VISITS * len(known), _FEWEST_STEPS), _MOST_STEPS)
        look, rest = divmod(state.iteration - _WARM_UP, gap)
        if rest or not 1 <= look <= _LOOKS:
            return
        if FITS in state.parameters:
            if _spread(_noted_fits(state)) > (_BEGUN_AT_FIRST if look == 1 else _BEGUN):
                begin_corrections(state, len(known))
            elif look == _LOOKS:
                _forget(state, FITS)
        elif look > 1 and _spread(known) < _DROP_BELOW:
            _forget(state, CORRECTIONS, STEPS)
            if look < _LOOKS:
                state.begin(FITS, known.detach().new_zeros(len(known), 4))

    def correction(self, state: SplatState, number: int) -> Tensor | None:
        """[3] of a training view, differentiable; None where photos are not corrected."""
        corrections = state.parameters.get(CORRECTIONS)
        return None if corrections is None else corrections[number]

    def fit(
        self, state: SplatState, progress: float, rendering: Rendering, target: Tensor, frame: Frame
    ) -> Tensor | None:
        """[3]: the correction that fits what was rendered of a view to its photo `target`, if it is asked for now."""
        fitted = state.iteration >= _WARM_UP and progress < _PHOTOMETRIC_FIT_UNTIL
        if not fitted or (CORRECTIONS not in state.parameters and FITS not in state.parameters):
            return None
        return fitted_correction(rendering.image[..., :3].detach(), target, rendering.alpha.detach(), frame.valid)

    @torch.no_grad()
    def step(self, state: SplatState, number: int, progress: float, fit: Tensor | None) -> None:
        """Changes the correction of one view, clears the gradient, and makes the mean over the photos zero.

        Args:
            state: after the backward pass of a step.
        """
        corrections = state.parameters.get(CORRECTIONS)
        if corrections is None:
            fits = state.parameters.get(FITS)
            if fits is not None and fit is not None:
                noted = fits.detach()[number]
                noted[:3].lerp_(fit, _FIT_SHARE if noted[3] else 1.0)
                noted[3] += 1
            return
        row = corrections.detach()[number]
        if corrections.grad is not None:
            moments = state.exp_avg[CORRECTIONS][number], state.exp_avg_sq[CORRECTIONS][number]
            if STEPS not in state.parameters:
                state.parameters[STEPS] = torch.zeros(len(corrections), device=corrections.device)
            steps = state.parameters[STEPS].detach()
            steps[number] += 1
            rate, backend = self._settings.rates.photometric_at(progress), self._settings.backend
            adam_update(row, corrections.grad[number], *moments, lr=rate, step=int(steps[number]), backend=backend)
            corrections.grad = None
        if fit is not None:
            row.lerp_(fit, _FIT_SHARE)
        corrections.copy_(zero_mean(corrections))


def photo_corrections(state: SplatState, views: Sequence[TrainingView]) -> dict[str, tuple[float, float, float]]:
    """Exposure, red and blue of each training photo by its name, EV; empty where photos were not corrected."""
    corrections = state.parameters.get(CORRECTIONS)
    if corrections is None:
        return {}
    rows = corrections.detach().cpu().tolist()
    return {view.name: (row[0], row[1], row[2]) for view, row in zip(views, rows, strict=True)}


def begin_corrections(state: SplatState, views: int) -> None:
    """Corrects the photos of a run from now on, by what was noted of them, if they are not corrected already."""
    if CORRECTIONS not in state.parameters:
        fits = _noted_fits(state) if FITS in state.parameters else state.parameters["means"].new_zeros(views, 3)
        _forget(state, FITS)
        state.begin(CORRECTIONS, fits)


def _noted_fits(state: SplatState) -> Tensor:
    """[V, 3] of mean zero; zero for a photo that could not be fitted."""
    noted = state.parameters[FITS].detach()
    seen, fits = noted[:, 3] > 0, noted[:, :3].clone()
    fits[seen] = zero_mean(fits[seen])
    return fits


def _forget(state: SplatState, *names: str) -> None:
    for tensors in (state.parameters, state.exp_avg, state.exp_avg_sq):
        for name in names:
            tensors.pop(name, None)


def _spread(corrections: Tensor) -> float:
    """How far photos differ, 1 from where they are taken to."""
    exposure, red, blue = corrections.detach().std(dim=0, correction=0).tolist()
    return float(max(exposure / _EXPOSURE_SPREAD, max(red, blue) / _BALANCE_SPREAD))
