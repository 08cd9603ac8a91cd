"""What both faces do alike when a capture comes in."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

from fastsplat.service.planning.presets import PresetName
from fastsplat_contract.errors import LimitExceededError
from fastsplat_contract.operations import Lens, Movers, Privacy, SceneOptions, UpAxis


def scene_options(
    labels: Sequence[str],
    time_budget_s: float | None,
    max_gaussians: int | None,
    preset: str,
    priority: int,
    up: str,
    movers: str,
    privacy: str,
    lens: str,
    nadir_deg: float | None,
) -> SceneOptions:
    """Options as sent; one string may hold several labels, separated by commas."""
    names = [part.strip() for text in labels for part in text.split(",")]
    return SceneOptions(
        tuple(name for name in names if name),
        time_budget_s,
        max_gaussians,
        cast(PresetName, preset) if preset else None,  # the service refuses what is none
        priority,
        cast(UpAxis, up) if up else None,
        cast(Movers, movers) if movers else None,
        cast(Privacy, privacy) if privacy else None,
        cast(Lens, lens) if lens else None,
        nadir_deg,
    )


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
