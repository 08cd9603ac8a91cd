"""Checks images of an upload: all headers before any decoding, then every row."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.formats.image_io import PhotoInfo, check_image, read_size
from fastsplat.service.capture.uploads.left_out import LeftOut
from fastsplat_contract.errors import CorruptImageError, LimitExceededError

_MAX_PIXELS_PER_BYTE = 200
"""Limit against decompression bombs: photos have about 4, plain synthetic images up to 50."""

_FREE_PIXELS = 256_000_000


def check_pixels(files: Path, names: Sequence[str], sent_bytes: int, settings: CaptureSettings) -> None:
    """Refuses images by their headers, before any decoding; invalid ones are ignored here.

    Raises:
        LimitExceededError: more than `max_images`, or more pixels than `max_pixels` or than their bytes allow.
    """
    if len(names) > 2 * settings.max_images:
        raise too_many_images(len(names), settings)
    pixels, ratio = 0, _MAX_PIXELS_PER_BYTE
    for name in names:
        try:
            width, height = read_size(files, name, settings)
        except (CorruptImageError, LimitExceededError):
            continue
        pixels += width * height
        if pixels > settings.max_pixels:
            raise LimitExceededError(
                "the images of the upload have too many pixels together",
                field=name,
                limit=f"{settings.max_pixels} pixels",
                hint="Send fewer or smaller images.",
            )
        if pixels > max(_FREE_PIXELS, ratio * sent_bytes):
            raise LimitExceededError(
                f"the images have more than {ratio} pixels a byte of the upload, as decompression bombs do",
                field=name,
                limit=f"{ratio} pixels a byte",
                hint="Send fewer or smaller images.",
            )


def transparency_warning(photos: Sequence[PhotoInfo]) -> tuple[str, ...]:
    """Makes a sentence for people about transparent pixels, if any."""
    count = sum(photo.transparent for photo in photos)
    return (f"{count} of the photos have transparent pixels, which are not trained on.",) if count else ()


def too_many_images(count: int, settings: CaptureSettings) -> LimitExceededError:
    """Makes the error of an upload with too many images."""
    return LimitExceededError(
        f"the upload has {count} images",
        field="files",
        limit=f"{settings.max_images} images (FASTSPLAT_CAPTURE__MAX_IMAGES)",
        hint="Send fewer images.",
    )


def usable_photos(
    files: Path, paths: Sequence[str], settings: CaptureSettings, left_out: LeftOut
) -> tuple[PhotoInfo, ...]:
    """Decodes images and returns the intact ones; raises `LimitExceededError` beyond `max_images`."""
    if len(paths) > settings.max_images:
        raise too_many_images(len(paths), settings)
    photos = []
    with ThreadPoolExecutor(max_workers=min(4, os.cpu_count() or 1)) as pool:
        jobs = [(path, pool.submit(check_image, files, path, settings)) for path in paths]
        try:
            for path, job in jobs:
                with left_out.costs(path):
                    photos.append(job.result())
        finally:
            pool.shutdown(cancel_futures=True)
    return tuple(photos)
