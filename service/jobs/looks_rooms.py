"""Drawn rooms with their truth, on which image-text models are calibrated."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from zipfile import ZipFile

import numpy as np
from numpy.typing import NDArray
from PIL import Image

ROOMS_FILE = Path(__file__).with_name("looks_rooms.zip")
"""Drawn by `benchmarks.calibration.draw_rooms`, which documents its entries."""


@dataclass(frozen=True)
class LabeledRoom:
    """Photos of a room with the true object of each pixel."""

    kind: str  # rooms of one kind have the same kinds of objects
    labels: Mapping[int, str]  # of each object id
    views: Sequence[tuple[NDArray[np.uint8], NDArray[np.uint8]]]  # RGB [H, W, 3] and object ids [H, W], 0 for none


def drawn_rooms() -> Iterator[LabeledRoom]:
    """Reads the rooms of `ROOMS_FILE`, one at a time."""
    with ZipFile(ROOMS_FILE) as archive:
        for name, labels in json.loads(archive.read("rooms.json")).items():
            files = sorted(file for file in archive.namelist() if file.startswith(f"{name}/") and file.endswith("webp"))
            views = [(_read(archive, file), _read(archive, file.replace("webp", "png"))) for file in files]
            yield LabeledRoom(name.split("-")[0], dict(enumerate(labels, start=1)), views)


def _read(archive: ZipFile, name: str) -> NDArray[np.uint8]:
    with archive.open(name) as stream, Image.open(stream) as picture:
        return np.asarray(picture)
