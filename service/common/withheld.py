"""Report of the pixels that redaction withheld."""

from __future__ import annotations

from dataclasses import dataclass

from fastsplat_contract.jobs.operations import Privacy


@dataclass(frozen=True)
class WithheldReport:
    """Withheld pixels of a capture."""

    privacy: Privacy | None  # promised
    photos: int  # with withheld pixels
    share: float  # of all pixels, each photo counted alike, 0..1
