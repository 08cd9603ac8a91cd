"""Limits and choices of the capture room."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class CaptureSettings(BaseModel):
    """Every limit on an upload, and how poses are found."""

    model_config = ConfigDict(frozen=True)

    max_upload_bytes: int = 2 * 2**30
    max_unpacked_bytes: int = 8 * 2**30
    max_entries: int = 20_000
    max_compression_ratio: int = 200
    max_image_pixels: int = 64_000_000
    max_images: int = 2_000
    max_side: int = 1_600
    """Images are reduced to this many pixels on the longer side before anything else looks at them."""
