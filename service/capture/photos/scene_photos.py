"""Small copies of a capture's photos that stay with its scene: `photos/00000.jpg` and so on in a version's folder.

A photo's number is that of its camera. The copies are undistorted, as the scene's pinhole cameras, and made of pixels
alone, without place or device. Beside them lie `lenses.json`, the lenses of those photos of which they are known, and
below `observed/` the photos of observations.
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

from fastsplat.service.capture.settings import PhotoSettings
from fastsplat.service.capture.types import Capture
from fastsplat.service.common.atomic import link_or_copy
from fastsplat.service.common.radial_lens import RadialLens
from fastsplat_contract.errors import SceneFileError

_FOLDER = "photos"
_LENSES = "lenses.json"


def write_photos(
    capture: Capture, folder: Path, settings: PhotoSettings, on_photo: Callable[[int], None] = lambda done: None
) -> int:
    """Write the copies of a capture's photos below the folder of a version; returns how many. None are written where
    the settings say so, nor of a capture whose pictures were rendered.

    Args:
        capture: whose views are the scene's cameras, in order.
        folder: of the version, which is not published yet.
        on_photo: called before each photo with how many there are; may raise `CancelledError`.
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
    """Where the photo of a scene's camera is, by the camera's number from 0, if there is one."""
    return folder / _FOLDER / f"{number:05d}.jpg"


def observed_photo_path(folder: Path, observation_id: str, number: int) -> Path:
    """Where a photo of an observation is, by its number in it from 0, if it is kept."""
    return folder / _FOLDER / "observed" / observation_id / f"{number:05d}.jpg"


def write_observed_photos(
    pictures: Sequence[NDArray[np.uint8]], folder: Path, observation_id: str, settings: PhotoSettings
) -> None:
    """Write the photos of an observation below the folder of a version, beside the scene's own, as those are.

    Args:
        pictures: uint8 [H, W, 3] each, RGB, undistorted.
        folder: of the version, which is not published yet.
    """
    for number, pixels in enumerate(pictures):
        path = observed_photo_path(folder, observation_id, number)
        path.parent.mkdir(parents=True, exist_ok=True)
        small = Image.fromarray(pixels)
        small.thumbnail((settings.max_side, settings.max_side), Image.Resampling.LANCZOS)
        _save(small, path, settings)


def _save(picture: Image.Image, path: Path, settings: PhotoSettings) -> None:
    # Optimized tables would save some percent, but a picture of noise does not fit into Pillow's buffer then.
    picture.save(path, format="JPEG", quality=settings.quality, subsampling=0)


def kept_lenses(folder: Path) -> tuple[RadialLens, ...]:
    """The lenses of those photos of a version of which they are known.

    Raises:
        SceneFileError: the file that has them is damaged.
    """
    path = folder / _FOLDER / _LENSES
    if not path.is_file():
        return ()
    try:
        return tuple(RadialLens(float(row["focal"]), float(row["k1"])) for row in json.loads(path.read_text()))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise SceneFileError("the kept lenses are damaged", field=path.name) from error


def share_photos(source: Path, target: Path) -> None:
    """Make the photos of one version those of another, too, which is not published yet: as links where the file
    system has them, else as copies."""
    if (source / _FOLDER).is_dir():
        shutil.copytree(source / _FOLDER, target / _FOLDER, copy_function=link_or_copy)
