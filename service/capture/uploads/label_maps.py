"""Reads label tables, assigns label maps to images, and checks them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.formats.bounded_json import read_json
from fastsplat.service.capture.formats.image_io import IMAGE_SUFFIXES, open_map
from fastsplat.service.common.dictionary import MAX_LABELS, UNDETECTED, Dictionary, dictionary_of
from fastsplat.service.common.file_names import common_folder
from fastsplat_contract.codec.unseen_characters import check_seen
from fastsplat_contract.errors import InvalidInputError

_HINT = 'Write {"mug": 1, "table": 2}, {"labels": {"mug": 1}} or ["mug", "table"]; 0 stays undetected.'
_MAX_NAME_LETTERS = 200
_MAX_LISTED_IDS = 8


@dataclass(frozen=True)
class LabelTable:
    """Names of the ids in a user's label maps."""

    names: tuple[str, ...]  # in id order; position + 1 is the capture's id
    ids: tuple[int, ...]  # the user's ids, possibly with gaps

    def dictionary(self) -> Dictionary:
        """Converts the names to a dictionary. Raises `InvalidInputError` if two mean the same."""
        return dictionary_of(self.names)

    def translate(self, user_ids: NDArray[np.uint16]) -> NDArray[np.uint16]:
        """Converts known user ids to dictionary ids, [H, W]."""
        table = np.zeros(MAX_LABELS + 1, dtype=np.uint16)
        table[list(self.ids)] = np.arange(1, len(self.ids) + 1)
        return np.asarray(table[user_ids])


def read_label_table(root: Path, name: str, settings: CaptureSettings) -> LabelTable:
    """Reads a labels.json below `root`. Raises as `read_json` and `parse_label_table`."""
    return parse_label_table(read_json(root / name, name, settings), field=name)


def parse_label_table(document: Any, *, field: str) -> LabelTable:
    """Parses a labels.json, or "labels" of a transforms.json.

    Raises:
        InvalidInputError: neither names to ids nor a list of names; an id twice, out of 1..65535, or not a whole
            number; a name twice (plural and spelling variants count as the same), empty or too long.
    """
    if isinstance(document, dict) and isinstance(document.get("labels"), dict | list):
        document = document["labels"]
    if isinstance(document, list):
        pairs: list[tuple[Any, Any]] = [(name, index + 1) for index, name in enumerate(document)]
    elif isinstance(document, dict):
        pairs = [(name, label_id) for name, label_id in document.items() if label_id is False or label_id != UNDETECTED]
    else:
        raise InvalidInputError(f"{field} has neither names with ids nor a list of names", field=field, hint=_HINT)
    for name, label_id in pairs:
        if not isinstance(name, str) or not name.strip() or len(name) > _MAX_NAME_LETTERS:
            raise InvalidInputError(f"{field}: {str(name)[:80]!r} is not a label name", field=field, hint=_HINT)
        check_seen(name.strip(), field)
        if type(label_id) is not int or not 1 <= label_id <= MAX_LABELS:
            raise InvalidInputError.of(
                field, f": the label {name!r} has the id {str(label_id)[:40]}", _HINT, f"whole numbers 1..{MAX_LABELS}"
            )
    pairs.sort(key=lambda pair: pair[1])
    names, ids = tuple(name.strip() for name, _ in pairs), tuple(label_id for _, label_id in pairs)
    if not names:
        raise InvalidInputError(f"{field} names no labels", field=field, hint=_HINT)
    if len(set(ids)) != len(ids):
        raise InvalidInputError(f"{field}: two labels share an id", field=field, hint=_HINT)
    table = LabelTable(names, ids)
    if len(table.dictionary()) != len(names):
        raise InvalidInputError.of(
            field,
            ": two labels share a name (plural and spelling variants count as the same)",
            "Give every kind of object one label.",
        )
    return table


def match_label_maps(label_maps: Iterable[str], images: Iterable[str], missing: Iterable[str] = ()) -> dict[str, str]:
    """Maps image paths to label map paths; label maps of `missing` images are ignored.

    A label map has the same path below `labels/` as its image below the images' common folder, without extension.

    Raises:
        InvalidInputError: a label map has no image.
    """
    images, missing = list(images), list(missing)
    folder = PurePosixPath(common_folder([*images, *missing]))
    image_by_key = {PurePosixPath(path).relative_to(folder).with_suffix("").as_posix(): path for path in images}
    missing_keys = {_without_suffix(PurePosixPath(path).relative_to(folder)) for path in missing}
    matches = {}
    for label_map in label_maps:
        parts = PurePosixPath(label_map).with_suffix("").parts
        key = "/".join(parts[parts.index("labels") + 1 :])
        if key in image_by_key:
            matches[image_by_key[key]] = label_map
        elif key not in missing_keys:
            raise InvalidInputError.of(label_map, "belongs to no image", "Name each label map like its image.")
    return matches


def check_label_map(
    root: Path, name: str, table: LabelTable, sizes: set[tuple[int, int]], settings: CaptureSettings
) -> None:
    """Refuses a label map that has none of the `sizes` (width, height), or unknown ids.

    Raises:
        InvalidInputError: another size, or an id that the table does not have.
        CorruptImageError, LimitExceededError: it cannot be decoded, or has too many pixels.
    """
    user_ids = open_map(root, name, settings)
    height, width = user_ids.shape
    if (width, height) not in sizes:
        expected = " or ".join(f"{w}×{h}" for w, h in sorted(sizes))
        raise InvalidInputError.of(
            name,
            f"has {width}×{height} pixels, its image has {expected}",
            "Send label maps of exactly their image's size.",
        )
    unknown = sorted(set(np.unique(user_ids).tolist()) - {UNDETECTED, *table.ids})
    if unknown:
        listed = ", ".join(str(label_id) for label_id in unknown[:_MAX_LISTED_IDS])
        raise InvalidInputError.of(
            name,
            f"has label ids without a name: {listed}{' …' if len(unknown) > _MAX_LISTED_IDS else ''}",
            "Name every id in the labels, or set its pixels to 0.",
        )


def _without_suffix(path: PurePosixPath) -> str:
    return (path.with_suffix("") if path.suffix.lower() in IMAGE_SUFFIXES else path).as_posix()
