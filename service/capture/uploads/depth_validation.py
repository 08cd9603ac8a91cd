"""Checks the depth maps of an upload before it is acknowledged: readable, of the right shape, and not empty."""

from __future__ import annotations

from pathlib import Path, PurePosixPath

from fastsplat.service.capture.formats.depth_files import IMAGE_SUFFIXES, depth_size, read_depth
from fastsplat.service.capture.photos.camera_model import aspect_error
from fastsplat.service.capture.settings import CaptureSettings
from fastsplat.service.capture.uploads.left_out import LeftOut
from fastsplat.service.capture.uploads.posed_input import PosedDataset
from fastsplat.service.common.file_names import list_names
from fastsplat_contract.errors import LimitExceededError

_LEAST_KNOWN = 0.01


def depth_images(dataset: PosedDataset) -> tuple[str, ...]:
    """Paths of the depth and confidence maps that are images, sorted."""
    depths = [image.depth for image in dataset.images if image.depth is not None]
    names = {name for depth in depths for name in (depth.path, depth.confidence) if name is not None}
    return tuple(sorted(name for name in names if PurePosixPath(name).suffix.lower() in IMAGE_SUFFIXES))


def check_depths(
    files: Path, dataset: PosedDataset, settings: CaptureSettings, left_out: LeftOut
) -> tuple[dict[str, tuple[int, int]], tuple[str, ...]]:
    """The sizes of the depth maps by their photo's path, and what is not used, as sentences for people.

    A map of which less than 1 % is known is left out, with a warning. One that is damaged, larger than images may be or
    in another aspect ratio than its camera costs its frame, which goes to `left_out`.

    Raises:
        LimitExceededError: together they have more than `max_pixels`.
    """
    sizes: dict[str, tuple[int, int]] = {}
    pixels, empty = 0, []
    for image in dataset.images:
        if image.depth is None:
            continue
        with left_out.costs(image.path):
            width, height = depth_size(files, image.depth, settings)
            if not image.camera_model.fits(width, height):
                raise aspect_error(image.depth.path, image.camera_model, width, height)
            pixels += width * height
            if pixels > settings.max_pixels:
                break
            known = read_depth(files, image.depth, settings) > 0
            if known.mean() < _LEAST_KNOWN:
                empty.append(image.name)
            else:
                sizes[image.path] = (width, height)
    if pixels > settings.max_pixels:
        raise LimitExceededError(
            "the depth maps of the upload have too many pixels together",
            field="files",
            limit=f"{settings.max_pixels} pixels",
            hint="Send fewer or smaller depth maps.",
        )
    if not empty:
        return sizes, ()
    warning = f"{len(empty)} depth maps have hardly a known pixel and are not used: {list_names(empty)}."
    return sizes, (warning,)
