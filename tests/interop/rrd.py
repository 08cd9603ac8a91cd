"""Rerun's own reader, for tests."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rerun.chunk import RrdReader

Components = dict[str, dict[str, list[Any]]]
_ROW_ID = "rerun.controls.RowId"


def recording_of(path: Path) -> tuple[str, str]:
    """Application and id of a file's only recording."""
    (entry,) = RrdReader(path).recordings()
    return entry.application_id, entry.recording_id


def components_of(path: Path) -> Components:
    """What each entity has, all of it static, by the component's name."""
    read: Components = {}
    for chunk in RrdReader(path).stream():
        assert chunk.is_static
        for component, rows in chunk.to_record_batch().to_pydict().items():
            if component != _ROW_ID:
                read.setdefault(chunk.entity_path, {})[component] = rows[-1]
    return read
