"""Limits and choices of the capture room."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field


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

    max_json_bytes: int = 16 * 2**20
    max_model_points: int = 5_000_000
    """Sparse points read from a COLMAP model or a PLY file."""
    max_video_frames_read: int = 36_000
    video_frames: int = 80
    """Frames kept of a video: the sharpest of so many equal intervals."""

    admit_memory_bytes: int = 6 * 2**30
    """Address space of the child process that looks into an upload before it is acknowledged."""
    admit_seconds: int = 900
    """How long it may look."""
    admit_at_once: int = Field(2, ge=1)
    """So many of them look at a time; more uploads wait for their turn."""

    sfm_memory_bytes: int = 8 * 2**30
    """Address space of the child process that runs structure from motion."""
    sfm_seconds: int = 4 * 3600
    sfm_threads: int = 0
    """Threads for features and matching; 0: one a core. The mapper runs on one, which makes its result repeatable."""
    sfm_max_side: int = 1_200
    """Features are looked for at no more than this many pixels on the longer side."""
    sfm_features: int = 4_096
    """Features an image."""
    exhaustive_images: int = 30
    """Up to so many images every pair is matched; beyond, the `pairs_per_image` most promising of each image."""
    pairs_per_image: int = 20
    min_points: int = 50
    """A reconstruction with fewer points is refused."""
    min_registered_share: float = 0.2
    """A reconstruction that places a smaller share of the images is refused."""
