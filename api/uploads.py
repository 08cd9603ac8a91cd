"""Uploads of captures, as far as both protocols handle them alike."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

from fastsplat_contract.errors import LimitExceededError
from fastsplat_contract.jobs.operations import SceneOptions

OPTIONS = frozenset(field.name for field in fields(SceneOptions)) - {"labels"}
"""Names of the options that both faces send as they are."""


def scene_options(labels: Sequence[str], sent: Mapping[str, Any]) -> SceneOptions:
    """Options as sent; the service refuses what is none.

    Args:
        labels: one string may hold several, separated by commas.
        sent: of `OPTIONS`; None and "" leave one open.
    """
    names = [part.strip() for text in labels for part in text.split(",")]
    options = {name: value for name, value in sent.items() if value not in (None, "")}
    return SceneOptions(tuple(name for name in names if name), **options)


def check_announced(size: int, max_upload_bytes: int) -> None:
    """Refuse at once, before a byte is read, an upload that says it will be too large.

    Raises:
        LimitExceededError: `size` passes the server's limit.
    """
    if size > max_upload_bytes:
        raise LimitExceededError(
            f"the upload announces {size} bytes",
            field="Content-Length",
            limit=f"{max_upload_bytes} bytes (FASTSPLAT_CAPTURE__MAX_UPLOAD_BYTES)",
            hint="Send fewer or smaller images.",
        )
