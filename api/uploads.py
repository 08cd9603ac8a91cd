"""Upload helpers shared by both protocols."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

from fastsplat.service.application.uploading.uploads import too_large
from fastsplat_contract.jobs.operations import SceneOptions

OPTIONS = frozenset(field.name for field in fields(SceneOptions)) - {"labels"}
"""Names of the options that both protocols pass on unchanged."""


def scene_options(labels: Sequence[str], sent: Mapping[str, Any]) -> SceneOptions:
    """Collects unvalidated options; labels may be comma-separated, None and "" are unset."""
    names = [part.strip() for text in labels for part in text.split(",")]
    options = {name: value for name, value in sent.items() if value not in (None, "")}
    return SceneOptions(tuple(name for name in names if name), **options)


def check_announced(size: int, max_upload_bytes: int) -> None:
    """Raises `LimitExceededError` if an upload's announced size, in bytes, passes the limit."""
    if size > max_upload_bytes:
        raise too_large(f"announces {size}", "Content-Length", max_upload_bytes)
