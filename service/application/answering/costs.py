"""Cost of a request, computed from its arguments and bounded before any work is done."""

from __future__ import annotations

from collections.abc import Iterable

from fastsplat.service.query.language.words.query_text import TextQuery
from fastsplat_contract.errors import LimitExceededError
from fastsplat_contract.geometry.camera import PosedCamera

_MAX_ENCODINGS = 1_024
"""Sentences that one question may have encoded: (texts + negatives) x templates."""
_MAX_QUESTION_PIXELS = 2**27
"""Pixels that one question may have rendered: views x texts."""


def check_encodings(query: TextQuery) -> None:
    """Raise if a question has too many sentences to encode: (texts + negatives) times templates.

    Raises:
        LimitExceededError: more than `_MAX_ENCODINGS`.
    """
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
    """Raise if a question has too many pixels to render: those of its views, for every text.

    Args:
        cameras: the views.
        masks: how many texts each is rendered for.

    Raises:
        LimitExceededError: more than `_MAX_QUESTION_PIXELS`.
    """
    views = [posed.camera for posed in cameras]
    pixels = masks * sum(camera.width * camera.height for camera in views)
    if pixels > _MAX_QUESTION_PIXELS:
        raise LimitExceededError(
            f"{masks} texts x {len(views)} views = {pixels} pixels to render",
            field="cameras",
            limit=f"{_MAX_QUESTION_PIXELS} pixels",
            hint="Ask in several requests, or for smaller views.",
        )
