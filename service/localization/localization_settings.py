"""Settings of `localize`: the photos' size and number."""

from __future__ import annotations

from pydantic import Field

from fastsplat.service.common.setting_groups import Options, SettingGroup


class LocalizationOptions(Options):
    """How large photos are looked at."""

    max_side: int = Field(800, ge=160, le=4_096)
    """Photos are reduced to this many pixels on the longer side, and so are the scene's own."""


class LocalizationSettings(LocalizationOptions, SettingGroup, section="localization"):
    """How photos find their place in a finished scene."""

    max_photos: int = Field(10, ge=1, le=64)
    """Photos of one request."""
