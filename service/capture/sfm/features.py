"""Extracts features. Runs only in the child process of `service.capture.untrusted.sandbox`."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

import pycolmap

_TRIED = 2  # first images of a step, which decide if octave -1 is needed for all


def extract_features(
    database: Path, images: Path, files: list[str], masks: Path | None, extraction: pycolmap.FeatureExtractionOptions
) -> None:
    """Writes features of images to a database, for masked ones where the mask is positive.

    COLMAP keeps the largest features, so octave -1, which takes most of the time, adds nothing if the others yield the
    requested number.

    Args:
        masks: folder with `<file>.png` for masked images; None: none is masked.
        extraction: options. From first octave 0, -1 is used only for images with too few features; it stays at -1 for
            later calls once all images tried first in a call have too few.
    """
    if extraction.sift.first_octave == -1:
        _extract(database, images, files, masks, extraction)
        return
    enough, tried = extraction.sift.max_num_features, files[:_TRIED]
    _extract(database, images, tried, masks, extraction)
    few = _with_fewer_features(database, tried, enough)
    ordinary = len(few) == len(tried)
    if ordinary:
        few = files
    else:
        _extract(database, images, files[_TRIED:], masks, extraction)
        few = _with_fewer_features(database, files, enough)
    _forget_features(database, few)
    extraction.sift.first_octave = -1
    _extract(database, images, few, masks, extraction)
    extraction.sift.first_octave = -1 if ordinary else 0


def _extract(
    database: Path, images: Path, files: list[str], masks: Path | None, extraction: pycolmap.FeatureExtractionOptions
) -> None:
    masked = [file for file in files if masks is not None and (masks / f"{file}.png").is_file()]
    for names, folder in ((masked, masks), ([file for file in files if file not in masked], None)):
        if not names:
            continue
        options = pycolmap.ImageReaderOptions()
        if folder is not None:  # COLMAP would skip images without a mask
            options.mask_path = folder
        pycolmap.extract_features(
            database,
            images,
            image_names=names,
            reader_options=options,
            extraction_options=extraction,
            device=pycolmap.Device.cpu,
        )


def _with_fewer_features(database: Path, files: list[str], enough: int) -> list[str]:
    with pycolmap.Database.open(database) as reader:
        counts = {image.name: reader.num_keypoints_for_image(image.image_id) for image in reader.read_all_images()}
    return [file for file in files if counts[file] < enough]


def _forget_features(database: Path, files: list[str]) -> None:
    with closing(sqlite3.connect(database)) as connection, connection:  # pycolmap can clear those of all images only
        for table in ("keypoints", "descriptors"):
            query = f"DELETE FROM {table} WHERE image_id = (SELECT image_id FROM images WHERE name = ?)"
            connection.executemany(query, [(file,) for file in files])
