"""Transforms a scene version's frame by scale and alignment to a map."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from pydantic import Field, TypeAdapter

from fastsplat.service.common.similarity import Similarity
from fastsplat_contract.geometry.viewpoint import WORLD


@dataclass(frozen=True)
class Alignment:
    """Pose of a scene in a map frame.

    x_map = R · (s · x_trained) + t with the scaling's factor s; lengths are in this version's units.
    """

    frame: str  # name of the map frame; may be empty
    rotation: tuple[tuple[float, float, float], ...]  # R, row-major
    translation: tuple[float, float, float]  # t
    pairs: Annotated[int, Field(ge=0)] = 0  # number of point pairs it was fitted to; 0 if the motion itself was given
    residuals: tuple[float, ...] = ()  # one per pair
    rms: float | None = None  # root mean square residual of the inliers; None without pairs
    outliers: tuple[int, ...] = ()  # indices of the pairs that the fit ignored
    scaled: bool = False  # whether the scene's scaling comes from pairs of points


def frame_name(alignment: Alignment | None) -> str:
    """Names the world frame: the map's ("map" if unnamed), or "world" without a map."""
    return WORLD if alignment is None else alignment.frame or "map"


def frame_similarity(meters_per_unit: float | None, alignment: Alignment | None) -> Similarity:
    """Maps the trained version's frame to that of a scaled and aligned version."""
    scale = 1.0 if meters_per_unit is None else meters_per_unit
    if alignment is None:
        return Similarity(scale, np.eye(3), np.zeros(3))
    return Similarity(scale, np.array(alignment.rotation), np.array(alignment.translation), frame_name(alignment))


_JSON: TypeAdapter[Alignment | None] = TypeAdapter(Alignment | None)


def alignment_to_json(alignment: Alignment | None) -> dict[str, Any] | None:
    """Converts an alignment to JSON values."""
    row: dict[str, Any] | None = _JSON.dump_python(alignment, mode="json")
    return row


def alignment_from_json(row: Mapping[str, Any] | None) -> Alignment | None:
    """Reads the output of `alignment_to_json`; raises `ValueError` for malformed values."""
    return _JSON.validate_python(row)
