"""Keeps small copies of a capture's photos with its scene, as `photos/00000.jpg` etc.

Numbered like the scene's cameras, undistorted, and without metadata such as place or device. Beside them lie
`lenses.json`, the known lenses, and `observed/`, photos of observations.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from fastsplat.service.capture.capture_settings import PhotoSettings
from fastsplat.service.capture.captures import Capture
from fastsplat.service.capture.formats.image_io import load_rgb
from fastsplat.service.capture.formats.reduced_images import limited
from fastsplat.service.common.files import link_or_copy
from fastsplat.service.common.radial_lens import RadialLens
from fastsplat_contract.errors import SceneFileError

_FOLDER = "photos"
_LENSES = "lenses.json"


def write_photos(
    capture: Capture, folder: Path, settings: PhotoSettings, on_photo: Callable[[int], None] = lambda done: None
) -> int:
    """Writes small copies of a capture's photos; returns their number.

    None are written if the settings forbid it or the pictures were rendered.

    Args:
        folder: of the version, which is not published yet.
        on_photo: called before each photo with the number done; may raise `CancelledError`.
    """
    if settings.keep == "off" or capture.report.source == "splat":
        return 0
    (folder / _FOLDER).mkdir()
    for number, view in enumerate(capture.views):
        on_photo(number)
        with Image.open(view.image_path) as image:
            small = image.convert("RGB")
        small.thumbnail((settings.max_side, settings.max_side), Image.Resampling.LANCZOS, reducing_gap=3.0)
        small.info.clear()
        _save(small, photo_path(folder, number), settings)
    lenses = [asdict(view.lens) for view in capture.views if view.lens is not None]
    (folder / _FOLDER / _LENSES).write_text(json.dumps(lenses))
    return len(capture.views)


def photo_path(folder: Path, number: int) -> Path:
    """Path of a camera's photo, by the camera's number from 0; it may not exist."""
    return folder / _FOLDER / f"{number:05d}.jpg"


def read_photo(path: Path, side: int) -> NDArray[np.uint8]:
    """Reads a kept photo, its longer side reduced to `side`; raises `SceneFileError`."""
    try:
        return limited(load_rgb(path), side)
    except OSError as error:
        raise SceneFileError(f"the photo {path.name} is damaged", field=path.name) from error


def observed_photo_path(folder: Path, observation_id: str, number: int) -> Path:
    """Path of an observation's photo, by its number from 0; it may not exist."""
    return folder / _FOLDER / "observed" / observation_id / f"{number:05d}.jpg"


def write_observed_photos(
    pictures: Sequence[NDArray[np.uint8]], folder: Path, observation_id: str, settings: PhotoSettings
) -> None:
    """Writes small copies of undistorted RGB photos of an observation to an unpublished version."""
    for number, pixels in enumerate(pictures):
        path = observed_photo_path(folder, observation_id, number)
        path.parent.mkdir(parents=True, exist_ok=True)
        small = Image.fromarray(pixels)
        small.thumbnail((settings.max_side, settings.max_side), Image.Resampling.LANCZOS)
        _save(small, path, settings)


def _save(picture: Image.Image, path: Path, settings: PhotoSettings) -> None:
    # Not optimized: that saves some percent, but a picture of noise overflows Pillow's buffer.
    picture.save(path, format="JPEG", quality=settings.quality, subsampling=0)


def kept_lenses(folder: Path) -> tuple[RadialLens, ...]:
    """Loads the known lenses of a version's photos.

    Raises:
        SceneFileError: the file is damaged.
    """
    path = folder / _FOLDER / _LENSES
    if not path.is_file():
        return ()
    try:
        return tuple(RadialLens(float(row["focal"]), float(row["k1"])) for row in json.loads(path.read_text()))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise SceneFileError("the kept lenses are damaged", field=path.name) from error


def share_photos(source: Path, target: Path) -> None:
    """Links the photos of a version into an unpublished one; copies if links fail."""
    if (source / _FOLDER).is_dir():
        shutil.copytree(source / _FOLDER, target / _FOLDER, copy_function=link_or_copy)
