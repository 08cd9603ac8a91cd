"""Reads photos that are kept with a version."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.capture.formats.image_io import load_rgb
from fastsplat.service.capture.formats.reduced_images import limited
from fastsplat_contract.errors import SceneFileError


def read_photo(path: Path, side: int) -> NDArray[np.uint8]:
    """Reads a kept photo, its longer side reduced to `side`; raises `SceneFileError`."""
    try:
        pixels = load_rgb(path)
    except OSError as error:
        raise SceneFileError(f"the photo {path.name} is damaged", field=path.name) from error
    return limited(pixels, side)
