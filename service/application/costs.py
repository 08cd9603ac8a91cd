"""What a request costs, known from its arguments and bounded before any work is done."""

from __future__ import annotations

from collections.abc import Iterable

from fastsplat.service.query.query_text import TextQuery
from fastsplat.service.settings import CallSettings
from fastsplat_contract.camera import PosedCamera
from fastsplat_contract.errors import LimitExceededError


def check_encodings(query: TextQuery, limits: CallSettings) -> None:
    """Raise if a question has too many sentences to encode: (texts + negatives) times templates.

    Raises:
        LimitExceededError: more than `limits.max_encodings`.
    """
    texts, negatives, templates = len(query.texts), len(query.negatives), len(query.templates)
    count = (texts + negatives) * templates
    if count > limits.max_encodings:
        raise LimitExceededError(
            f"({texts} texts + {negatives} negatives) x {templates} templates = {count} sentences to encode",
            field="templates",
            limit=f"{limits.max_encodings} sentences (FASTSPLAT_CALLS__MAX_ENCODINGS)",
            hint="Ask in several requests, or with fewer templates.",
        )


def rendering_cost(cameras: Iterable[PosedCamera], masks: int, gaussians: int) -> float:
    """What views cost, in rendered pixels: in each, a Gaussian takes about as long as a pixel.

    Args:
        cameras: the views.
        masks: how many texts each is rendered for.
        gaussians: of the scene.
    """
    return masks * sum(posed.camera.width * posed.camera.height + gaussians for posed in cameras)


def check_pixels(cameras: Iterable[PosedCamera], masks: int, limits: CallSettings) -> None:
    """Raise if a question has too many pixels to render: those of its views, for every text.

    Args:
        cameras: the views.
        masks: how many texts each is rendered for.
        limits: the server's.

    Raises:
        LimitExceededError: more than `limits.max_pixels`.
    """
    views = [posed.camera for posed in cameras]
    pixels = masks * sum(camera.width * camera.height for camera in views)
    if pixels > limits.max_pixels:
        raise LimitExceededError(
            f"{masks} texts x {len(views)} views = {pixels} pixels to render",
            field="cameras",
            limit=f"{limits.max_pixels} pixels (FASTSPLAT_CALLS__MAX_PIXELS)",
            hint="Ask in several requests, or for smaller views.",
        )
