"""Labelling on disk: `dictionary.json`, 16-bit PNGs of labels and regions, NPZs of masks."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import cv2
import numpy as np
from numpy.typing import NDArray

from fastsplat.service.common.dictionary import Dictionary, DictionaryEntry
from fastsplat.service.perception.results import Labelling, Regions, ViewMasks
from fastsplat_contract.errors import InvalidInputError

_INDEX = "dictionary.json"


def save_labelling(labelling: Labelling, directory: Path) -> None:
    """Writes a labelling to `directory`, replacing it as a whole by a rename."""
    directory.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f".{directory.name}-", dir=directory.parent) as work:
        staged = Path(work) / "new"
        staged.mkdir()
        for index, label_map in enumerate(labelling.label_maps):
            if not cv2.imwrite(str(staged / f"{index:06d}.png"), label_map):
                raise OSError(f"{staged / f'{index:06d}.png'} could not be written")
        for index, view in enumerate(labelling.regions):
            if not cv2.imwrite(str(staged / f"regions-{index:06d}.png"), view.ids):
                raise OSError(f"{staged / f'regions-{index:06d}.png'} could not be written")
        for index, masks in enumerate(labelling.masks):
            if masks is not None:
                shape = np.array([masks.width, masks.height, masks.prompts], np.int64)
                np.savez_compressed(staged / _masks_name(index), bits=masks.bits, quality=masks.quality, shape=shape)
        index_text = json.dumps(
            {
                "schema_version": 1,
                "maps": len(labelling.label_maps),
                "exact": labelling.exact,
                "votes": [view.votes for view in labelling.regions],
                "searched": labelling.searched,
                "detector": labelling.detector,
                "masks": [masks is not None for masks in labelling.masks],
                "entries": [asdict(entry) for entry in labelling.dictionary.entries],
            },
            ensure_ascii=False,
            indent=1,
        )
        (staged / _INDEX).write_text(index_text, "utf-8")
        for path in staged.iterdir():
            with path.open("rb") as stream:
                os.fsync(stream.fileno())
        if directory.exists():
            directory.rename(Path(work) / "old")
        try:
            staged.rename(directory)
        except OSError:
            if (Path(work) / "old").exists():
                shutil.move(Path(work) / "old", directory)
            raise


def load_labelling(directory: Path) -> Labelling:
    """Reads what `save_labelling` wrote; damage raises `InvalidInputError`."""
    try:
        index = json.loads((directory / _INDEX).read_text("utf-8"))
        if index["schema_version"] != 1:
            raise ValueError(f"schema version {index['schema_version']}")
        entries = tuple(
            DictionaryEntry(
                str(entry["label"]),
                tuple(entry["aliases"]),
                int(entry["pixels"]),
                int(entry["views"]),
                float(entry["confidence"]),
            )
            for entry in index["entries"]
        )
        dictionary = Dictionary(entries)
        maps: list[NDArray[np.uint16]] = []
        exact = index["exact"]
        if not isinstance(exact, bool):
            raise ValueError(f"exact is {exact}")
        for number in range(int(index["maps"])):
            maps.append(_read_map(directory / f"{number:06d}.png", len(entries)))
        regions = tuple(
            Regions(_read_map(directory / f"regions-{number:06d}.png", len(votes)), _checked(votes, len(entries)))
            for number, votes in enumerate(index["votes"])
        )
        if len(regions) not in (0, len(maps)):
            raise ValueError(f"{len(regions)} region maps for {len(maps)} label maps")
        masks = tuple(
            _read_masks(directory / _masks_name(number)) if present else None
            for number, present in enumerate(index["masks"])
        )
        if len(masks) not in (0, len(maps)):
            raise ValueError(f"masks of {len(masks)} views for {len(maps)} label maps")
        names = index["searched"]
        searched, detector = None if names is None else tuple(str(name) for name in names), str(index["detector"])
    except (OSError, EOFError, ValueError, KeyError, TypeError, BadZipFile, InvalidInputError) as error:
        raise InvalidInputError(f"{directory} holds no labelling: {error}", field=str(directory.name)) from error
    return Labelling(dictionary, tuple(maps), exact, regions, masks, searched, detector=detector)


def _masks_name(number: int) -> str:
    return f"masks-{number:06d}.npz"


def _read_masks(path: Path) -> ViewMasks:
    with np.load(path, allow_pickle=False) as stored:
        bits, quality, shape = stored["bits"], stored["quality"], stored["shape"]
    if bits.dtype != np.uint8 or quality.dtype != np.float32 or shape.shape != (3,) or shape.dtype != np.int64:
        raise ValueError(f"{path.name} holds no masks")
    width, height, prompts = shape.tolist()
    if min(width, height) < 1 or prompts < 0 or bits.shape != (len(quality), -(-width * height // 8)):
        raise ValueError(f"{path.name} has masks of another size than it says")
    return ViewMasks(bits, quality, width, height, prompts)


def _read_map(path: Path, highest: int) -> NDArray[np.uint16]:
    stored = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if stored is None or stored.ndim != 2 or stored.dtype != np.uint16:
        raise ValueError(f"{path.name} is not a 16-bit grey image")
    if int(stored.max(initial=0)) > highest:
        raise ValueError(f"{path.name} has an id above {highest}")
    return np.asarray(stored, np.uint16)


def _checked(votes: Any, labels: int) -> tuple[tuple[tuple[int, float], ...], ...]:
    parsed = tuple(tuple((int(label), float(score)) for label, score in region) for region in votes)
    if any(not (1 <= label <= labels and 0 <= score <= 1) for region in parsed for label, score in region):
        raise ValueError("a vote is for no label of the dictionary, or its score is not in 0..1")
    return parsed
