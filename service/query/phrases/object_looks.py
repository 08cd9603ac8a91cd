"""Compares texts with the appearance of objects by a calibrated image-text model.

Used if no name answers. Uncalibrated cosines mean nothing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.common.logistic import logistic
from fastsplat.service.query.language.meaning.probability import Logistic
from fastsplat.service.scene.artefact.scene import Object

if TYPE_CHECKING:  # onnxruntime loads when it is used
    from fastsplat.service.perception.results import TextEncoder

_CLEAREST = 6.0
"""Clip of log-likelihood ratios, so that looks make nothing certain."""
_LIKELIEST = 0.999


@dataclass(frozen=True)
class LooksModel:
    """A calibrated image-text model."""

    encoder: TextEncoder  # its network of texts
    ratio: Logistic  # of a score's log-likelihood ratio; the lead is over the median of the scene's objects


@dataclass(frozen=True)
class ObjectLooks:
    """Looks of one scene's objects; thread-safe."""

    objects: tuple[Object, ...] = field(repr=False)  # of the scene; only those count that this very model looked at
    model: LooksModel | None  # compares; None: nothing does

    def __bool__(self) -> bool:
        return bool(self._ids)

    @cached_property
    def _ids(self) -> tuple[int, ...]:
        return () if self.model is None else tuple(obj.id for obj in self._looked_at)

    @property
    def _looked_at(self) -> list[Object]:
        known = "" if self.model is None else self.model.encoder.sha256
        return [obj for obj in self.objects if obj.looks is not None and obj.looks.sha256 == known]

    @cached_property
    def _rows(self) -> NDArray[np.float64]:
        looks = [obj.looks.embedding for obj in self._looked_at if obj.looks is not None]
        return np.stack([np.frombuffer(look, np.float16) for look in looks]).astype(np.float64)

    def likely(self, text: str, before: Mapping[int, float]) -> Mapping[int, float]:
        """Posterior probability, 0..1, that a noun phrase is true of each object with looks.

        `before` has the priors. Raises ModelUnavailableError if the text network embeds in another size."""
        if self.model is None or not self:
            return {}
        ratio = ratios_of(self._rows @ self.model.encoder.encode([text])[0], self.model.ratio)
        known = np.clip([before[object_id] for object_id in self._ids], 1 - _LIKELIEST, _LIKELIEST)
        together = logistic(np.log(known / (1 - known)) + ratio)
        return dict(zip(self._ids, together.tolist(), strict=True))


def ratios_of(cosines: NDArray[np.floating], ratio: Logistic) -> NDArray[np.float64]:
    """Log-likelihood ratios of the cosines [K] of a scene's objects with one text, float64 [K].

    The lead over their median removes what all texts and pictures have in common."""
    rows = np.asarray(cosines, np.float64)
    weighed = ratio.score * rows + ratio.lead * (rows - np.median(rows)) + ratio.offset
    return np.asarray(np.clip(weighed, -_CLEAREST, _CLEAREST))
