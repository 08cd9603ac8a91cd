"""The numbers of fields and enum values. They are given once, in the order of appearance, and are never used again."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path

_FIRST = 1


class Registry:
    """Numbers by message or enum and by the name of a field or value.

    Args:
        path: a JSON file, `{"Scene": {"id": 1, ...}, ...}`.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._numbers: dict[str, dict[str, int]] = json.loads(path.read_text())

    def numbers(self, owner: str, names: Iterable[str]) -> Mapping[str, int]:
        """The numbers of `names`, ascending; names that are new get those after the highest that `owner` ever had."""
        known = self._numbers.setdefault(owner, {})
        names = list(names)
        for name in names:
            known.setdefault(name, max(known.values(), default=_FIRST - 1) + 1)
        return dict(sorted(((name, known[name]) for name in names), key=lambda item: item[1]))

    def retired(self, owner: str, names: Iterable[str]) -> Mapping[str, int]:
        """What `owner` once had and has no more, ascending."""
        gone = {name: number for name, number in self._numbers.get(owner, {}).items() if name not in set(names)}
        return dict(sorted(gone.items(), key=lambda item: item[1]))

    def save(self) -> None:
        """Write the file, with the new names."""
        lines = [f"  {json.dumps(owner)}: {json.dumps(numbers)}" for owner, numbers in sorted(self._numbers.items())]
        self._path.write_text("{\n" + ",\n".join(lines) + "\n}\n")
