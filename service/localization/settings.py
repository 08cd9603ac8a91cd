"""Settings of `localize`: how large photos are looked at, and what one request may bring."""

from __future__ import annotations

from pydantic import Field

from fastsplat.service.common.settings import SettingGroup


class LocalizationSettings(SettingGroup, section="localization"):
    """How photos find their place in a finished scene."""

    max_photos: int = Field(8, ge=1, le=64)
    """Photos of one request."""
    max_bytes: int = Field(32 * 2**20, ge=1024)
    """Bytes of all photos of a request over REST; over gRPC a message has at most 4 MiB."""
    max_side: int = Field(800, ge=160, le=4_096)
    """Photos are reduced to this many pixels on the longer side, and so are the scene's own."""
    keypoints: int = Field(2_000, ge=100, le=20_000)
    """Places of a photo that are looked for in the scene."""
    matched_views: int = Field(8, ge=1)
    """Photos of the scene that a photo is compared with in full, the most promising ones."""
    max_views: int = Field(300, ge=1)
    """Photos of the scene that are known again; of more, so many are taken, evenly through their order."""
