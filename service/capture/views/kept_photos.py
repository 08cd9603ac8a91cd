"""Photos that are kept with a version, read for whoever looks at them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.capture.formats.image_io import load_rgb
from fastsplat.service.capture.untrusted.image_decoding import reduce, reduced_size
from fastsplat_contract.errors import SceneFileError


def read_photo(path: Path, side: int) -> NDArray[np.uint8]:
    """uint8 [H, W, 3] of a photo that is kept with a version.

    Args:
        side: it is reduced to so many pixels on the longer side.

    Raises:
        SceneFileError: it is damaged, or gone.
    """
    try:
        pixels = load_rgb(path)
    except OSError as error:
        raise SceneFileError(f"the photo {path.name} is damaged", field=path.name) from error
    return reduce(pixels, reduced_size(pixels.shape[1], pixels.shape[0], side))
