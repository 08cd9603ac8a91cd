"""Maps the first images while the others wait, for display only."""

from __future__ import annotations

from pathlib import Path

import pycolmap

from fastsplat.service.capture.sfm.mapping import largest_first, mapper_options
from fastsplat.service.capture.sfm.mapping_snapshots import keep

FIRST_IMAGES = 8
"""Mapped at once, if a capture has twice as many; others are mapped soon anyway."""
_APART = 2


def first_pairs() -> list[tuple[int, int]]:
    """Pairs matched before all others: neighbors and next neighbors, which every capture matches."""
    return [(i, i + step) for step in range(1, _APART + 1) for i in range(FIRST_IMAGES - step)]


def place_first(database: Path, images: Path, folder: Path) -> bool:
    """Maps the images matched so far and stores their cameras for `take_placed`.

    Returns:
        False without cameras; the first photos may be from one place or share nothing.
    """
    output = folder / "first"
    output.mkdir()
    models = largest_first(pycolmap.incremental_mapping(database, images, output, options=mapper_options()).values())
    if models:
        keep(models[0], folder)
    return bool(models)
