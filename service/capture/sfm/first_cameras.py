"""The first images of a capture get cameras while the others wait: something to look at, which nothing relies on."""

from __future__ import annotations

from pathlib import Path

import pycolmap

from fastsplat.service.capture.sfm.mapping import largest_first, mapper_options
from fastsplat.service.capture.sfm.mapping_snapshots import keep

FIRST_IMAGES = 8
"""Mapped at once; of fewer than twice as many images the whole capture is mapped soon enough."""
_APART = 2


def first_pairs() -> list[tuple[int, int]]:
    """Those of the first images that are matched before all others: neighbors, and neighbors but one, which are matched
    in any capture, so that nothing is matched in vain."""
    return [(i, i + step) for step in range(1, _APART + 1) for i in range(FIRST_IMAGES - step)]


def place_first(database: Path, images: Path, folder: Path) -> bool:
    """Leave the cameras that images get by the matches so far for `take_placed`.

    Args:
        database: with features and verified matches of some images.

    Returns:
        Whether any has one: the first photos may have been taken from one place, or show nothing in common.
    """
    output = folder / "first"
    output.mkdir()
    models = largest_first(pycolmap.incremental_mapping(database, images, output, options=mapper_options()).values())
    if models:
        keep(models[0], folder)
    return bool(models)
