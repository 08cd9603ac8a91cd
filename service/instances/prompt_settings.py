"""Settings of edits by prompts: `split` and `add`."""

from __future__ import annotations

from pydantic import Field

from fastsplat.service.common.settings import Options


class PromptOptions(Options):
    """How a thing that somebody points at in one view is segmented, there and in others."""

    views: int = Field(3, ge=1)
    """Views that are rendered and segmented, the one that was pointed at included; each takes about a second."""
    max_side: int = Field(640, ge=64)
    """They are rendered at this many pixels on the longer side, and never larger than they are."""
