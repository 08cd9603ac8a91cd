"""Label maps on disk: `dictionary.json` and one 16-bit PNG a view."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from dataclasses import asdict
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from service.common.dictionary import Dictionary, DictionaryEntry
from service.common.errors import InvalidInputError
from service.perception.types import Labelling

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
        index_text = json.dumps(
            {
                "schema_version": 1,
                "maps": len(labelling.label_maps),
                "exact": labelling.exact,
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
            DictionaryEntry(str(e["label"]), tuple(e["aliases"]), int(e["pixels"]), int(e["views"]))
            for e in index["entries"]
        )
        maps: list[NDArray[np.uint16]] = []
        exact = index.get("exact", False)
        if not isinstance(exact, bool):
            raise ValueError(f"exact is {exact!r}")
        for number in range(int(index["maps"])):
            label_map = cv2.imread(str(directory / f"{number:06d}.png"), cv2.IMREAD_UNCHANGED)
            if label_map is None or label_map.ndim != 2 or label_map.dtype != np.uint16:
                raise ValueError(f"{number:06d}.png is not a 16-bit grey image")
            if int(label_map.max(initial=0)) > len(entries):
                raise ValueError(f"{number:06d}.png has an id that the dictionary does not")
            maps.append(np.asarray(label_map, np.uint16))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InvalidInputError(f"{directory} holds no labelling: {error}", field=str(directory.name)) from error
    return Labelling(Dictionary(entries), tuple(maps), exact)
