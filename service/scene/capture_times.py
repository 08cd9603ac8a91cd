"""When the photos of a scene's capture were taken."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

from fastsplat.service.scene.types import TAKEN_AT


def newest_photo_at(quality: Mapping[str, Any]) -> datetime | None:
    """When the newest photo of a scene with this quality was taken; None where its photos do not say it."""
    taken = quality.get(TAKEN_AT)
    times = [float(each) for each in taken.values()] if isinstance(taken, Mapping) else []
    return datetime.fromtimestamp(max(times), UTC) if times else None
