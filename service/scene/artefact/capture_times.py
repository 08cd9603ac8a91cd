"""Capture times of a scene's photos."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

from fastsplat.service.scene.artefact.scene import TAKEN_AT


def newest_photo_at(quality: Mapping[str, Any]) -> datetime | None:
    """Returns the capture time of the newest photo; None if unknown."""
    taken = quality.get(TAKEN_AT)
    times = [float(each) for each in taken.values()] if isinstance(taken, Mapping) else []
    return datetime.fromtimestamp(max(times), UTC) if times else None
