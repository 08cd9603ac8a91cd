"""Made photos on disk, for a page that uploads them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.capture.upload_files import encoded


def photo(side: int, seed: int) -> bytes:
    """A JPEG of noise."""
    pixels = np.random.default_rng(seed).integers(0, 255, (side, side, 3), dtype=np.uint8)
    return encoded(pixels, "JPEG", quality=95)


def write_photos(folder: Path, count: int, seed: int = 0) -> list[Path]:
    """Small photos, each another one."""
    paths = [folder / f"{number}.jpg" for number in range(count)]
    for number, path in enumerate(paths):
        path.write_bytes(photo(64, seed + number))
    return paths
