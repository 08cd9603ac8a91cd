"""Settings of edits by prompts: `split` and `add`."""

from __future__ import annotations

from pydantic import Field

from fastsplat.service.common.settings import SettingGroup


class PromptSettings(SettingGroup, section="prompts"):
    """How a thing that somebody points at in one view is segmented, there and in others."""

    views: int = Field(3, ge=1)
    """Views that are rendered and segmented, the one that was pointed at included; each takes about a second."""
    max_side: int = Field(640, ge=64)
    """They are rendered at this many pixels on the longer side, and never larger than they are."""
    max_pixels: int = Field(64, ge=1)
    """Pixels on and beside the thing that one prompt may have."""
    kept_views: int = Field(16, ge=0)
    """Views of which the segmenter's answer to the picture is kept for the next prompt, about 4 MiB each; the least
    recently used leave first."""
