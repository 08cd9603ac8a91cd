"""The frame of a version: how its coordinates follow from those of the trained one, by scale and alignment."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from fastsplat.service.common.similarity import Similarity


@dataclass(frozen=True)
class Alignment:
    """How a scene lies in the frame of a map: x_map = R · (s · x_trained) + t, s by the scene's scaling.

    Attributes:
        frame: the map frame's name; may be empty.
        rotation: R, three rows of three.
        translation: t, units of this version.
        pairs: of points that it comes from; 0 where the motion itself was given.
        residuals: of each pair, units of this version.
        rms: root mean square of those that are no outliers; None without pairs.
        outliers: numbers of the pairs, from 0, that fit the others badly and did not count.
        scaled: whether the scene's scaling comes from pairs of points.
    """

    frame: str
    rotation: tuple[tuple[float, float, float], ...]
    translation: tuple[float, float, float]
    pairs: int = 0
    residuals: tuple[float, ...] = ()
    rms: float | None = None
    outliers: tuple[int, ...] = ()
    scaled: bool = False


def frame_similarity(meters_per_unit: float | None, alignment: Alignment | None) -> Similarity:
    """From the frame of the trained version into that of a version with this scaling and alignment."""
    scale = 1.0 if meters_per_unit is None else meters_per_unit
    if alignment is None:
        return Similarity(scale, np.eye(3), np.zeros(3))
    return Similarity(scale, np.array(alignment.rotation), np.array(alignment.translation))


def alignment_to_json(alignment: Alignment | None) -> dict[str, Any] | None:
    """An alignment as plain values."""
    if alignment is None:
        return None
    return {
        **asdict(alignment),
        "rotation": [list(row) for row in alignment.rotation],
        "translation": list(alignment.translation),
        "residuals": list(alignment.residuals),
        "outliers": list(alignment.outliers),
    }


def alignment_from_json(row: Mapping[str, Any] | None) -> Alignment | None:
    """What `alignment_to_json` wrote."""
    if row is None:
        return None
    first, second, third = (tuple(line) for line in row["rotation"])
    return Alignment(
        frame=row["frame"],
        rotation=(first, second, third),
        translation=tuple(row["translation"]),
        pairs=row["pairs"],
        residuals=tuple(row["residuals"]),
        rms=row["rms"],
        outliers=tuple(row["outliers"]),
        scaled=row["scaled"],
    )
