"""Label maps that a user brings: names and ids, checked against each other."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.capture.images import open_map
from fastsplat.service.capture.settings import CaptureSettings
from fastsplat.service.common.dictionary import MAX_LABELS, UNDETECTED, Dictionary, dictionary_of
from fastsplat_contract.errors import InvalidInputError

_HINT = 'Write {"mug": 1, "table": 2}, {"labels": {"mug": 1}} or ["mug", "table"]; 0 stays undetected.'
_MAX_NAME = 200


@dataclass(frozen=True)
class LabelTable:
    """Names of the ids in a user's label maps.

    Attributes:
        names: in id order; their position + 1 is the id that the capture uses.
        ids: the user's id of each name; they may have gaps.
    """

    names: tuple[str, ...]
    ids: tuple[int, ...]

    def dictionary(self) -> Dictionary:
        """Raises `InvalidInputError` when two names mean the same."""
        return dictionary_of(self.names)

    def translate(self, stored: NDArray[np.uint16]) -> NDArray[np.uint16]:
        """uint16 [H, W] of the user's ids to ids of the dictionary; the ids must be known."""
        table = np.zeros(MAX_LABELS + 1, dtype=np.uint16)
        table[list(self.ids)] = np.arange(1, len(self.ids) + 1)
        return np.asarray(table[stored])


def label_table(document: Any, *, field: str) -> LabelTable:
    """Read what `labels.json`, or "labels" of a transforms.json, says.

    Raises:
        InvalidInputError: neither names to ids nor a list of names; an id twice, out of 1..65535, or no whole number; a
            name twice (plural and spelling variants count as the same), empty or too long.
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
        if not isinstance(name, str) or not name.strip() or len(name) > _MAX_NAME:
            raise InvalidInputError(f"{field}: {str(name)[:80]!r} is no label name", field=field, hint=_HINT)
        if type(label_id) is not int or not 1 <= label_id <= MAX_LABELS:
            raise InvalidInputError(
                f"{field}: the label {name!r} has the id {str(label_id)[:40]}",
                field=field,
                limit=f"whole numbers 1..{MAX_LABELS}",
                hint=_HINT,
            )
    pairs.sort(key=lambda pair: pair[1])
    names, ids = tuple(name.strip() for name, _ in pairs), tuple(label_id for _, label_id in pairs)
    if not names:
        raise InvalidInputError(f"{field} names no labels", field=field, hint=_HINT)
    if len(set(ids)) != len(ids):
        raise InvalidInputError(f"{field}: two labels share an id", field=field, hint=_HINT)
    table = LabelTable(names, ids)
    if len(table.dictionary()) != len(names):
        raise InvalidInputError(
            f"{field}: two labels share a name (plural and spelling variants count as the same)",
            field=field,
            hint="Give every kind of thing one label.",
        )
    return table


def check_label_map(
    root: Path, name: str, table: LabelTable, sizes: set[tuple[int, int]], settings: CaptureSettings
) -> None:
    """Refuse a label map that does not fit its image or its table.

    Args:
        sizes: (width, height) that the map may have.

    Raises:
        InvalidInputError: another size, or an id that the table does not have.
        CorruptImageError, LimitExceededError: it cannot be decoded, or has too many pixels.
    """
    stored = open_map(root, name, settings)
    height, width = stored.shape
    if (width, height) not in sizes:
        expected = " or ".join(f"{w}×{h}" for w, h in sorted(sizes))
        raise InvalidInputError(
            f"{name} has {width}×{height} pixels, its image has {expected}",
            field=name,
            hint="Send label maps of exactly their image's size.",
        )
    unknown = sorted(set(np.unique(stored).tolist()) - {UNDETECTED, *table.ids})
    if unknown:
        shown = ", ".join(str(label_id) for label_id in unknown[:8])
        raise InvalidInputError(
            f"{name} has label ids without a name: {shown}{' …' if len(unknown) > 8 else ''}",
            field=name,
            hint="Name every id in the labels, or set its pixels to 0.",
        )
