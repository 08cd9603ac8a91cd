"""Label maps on disk: `dictionary.json` and one 16-bit PNG a view, two where regions were detected."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from fastsplat.service.common.dictionary import Dictionary, DictionaryEntry
from fastsplat.service.perception.types import Labelling, Regions
from fastsplat_contract.errors import InvalidInputError

_INDEX = "dictionary.json"


def save_labelling(labelling: Labelling, directory: Path) -> None:
    """Write `dictionary.json`, `000000.png`, ... into `directory`, replacing it whole.

    The folder is written beside its place and renamed into it: a reader sees the old one, none for an instant, or all
    of the new one.
    """
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
        index_text = json.dumps(
            {
                "schema_version": 1,
                "maps": len(labelling.label_maps),
                "exact": labelling.exact,
                "expected": labelling.expected,
                "votes": [view.votes for view in labelling.regions],
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
    """Read what `save_labelling` wrote.

    Raises:
        InvalidInputError: a file is missing or damaged, or ids and dictionary disagree.
    """
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
                float(entry.get("confidence", 1.0)),  # the first release wrote none
            )
            for entry in index["entries"]
        )
        dictionary = Dictionary(entries)
        maps: list[NDArray[np.uint16]] = []
        flags = [index.get(name, False) for name in ("exact", "expected")]
        if not all(isinstance(flag, bool) for flag in flags):
            raise ValueError(f"exact and expected are {flags}")
        for number in range(int(index["maps"])):
            maps.append(_read_map(directory / f"{number:06d}.png", len(entries)))
        regions = tuple(
            Regions(_read_map(directory / f"regions-{number:06d}.png", len(votes)), _checked(votes, len(entries)))
            for number, votes in enumerate(index.get("votes", []))
        )
        if len(regions) not in (0, len(maps)):
            raise ValueError(f"{len(regions)} region maps for {len(maps)} label maps")
    except (OSError, ValueError, KeyError, TypeError, InvalidInputError) as error:
        raise InvalidInputError(f"{directory} holds no labelling: {error}", field=str(directory.name)) from error
    return Labelling(dictionary, tuple(maps), flags[0], regions, flags[1])


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
