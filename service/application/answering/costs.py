"""Cost limits of a request, checked before any work."""

from __future__ import annotations

from collections.abc import Iterable

from fastsplat.service.query.language.words.query_text import TextQuery
from fastsplat_contract.errors import LimitExceededError
from fastsplat_contract.geometry.camera import PosedCamera

_MAX_ENCODINGS = 1_024
"""Limit of sentences to encode per query: (texts + negatives) x templates."""
_MAX_QUESTION_PIXELS = 2**27
"""Limit of pixels to render per query: views x texts."""


def check_encodings(query: TextQuery) -> None:
    """Raises `LimitExceededError` for more than `_MAX_ENCODINGS` sentences to encode."""
    texts, negatives, templates = len(query.texts), len(query.negatives), len(query.templates)
    count = (texts + negatives) * templates
    if count > _MAX_ENCODINGS:
        raise LimitExceededError(
            f"({texts} texts + {negatives} negatives) x {templates} templates = {count} sentences to encode",
            field="templates",
            limit=f"{_MAX_ENCODINGS} sentences",
            hint="Ask in several requests, or with fewer templates.",
        )


def check_pixels(cameras: Iterable[PosedCamera], masks: int) -> None:
    """Raises `LimitExceededError` for more than `_MAX_QUESTION_PIXELS`; `masks` is the number of texts."""
    views = [posed.camera for posed in cameras]
    pixels = masks * sum(camera.width * camera.height for camera in views)
    if pixels > _MAX_QUESTION_PIXELS:
        raise LimitExceededError(
            f"{masks} texts x {len(views)} views = {pixels} pixels to render",
            field="cameras",
            limit=f"{_MAX_QUESTION_PIXELS} pixels",
            hint="Ask in several requests, or for smaller views.",
        )
