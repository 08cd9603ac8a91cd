"""Loads settings on first use: they are a third of a mere `--help`."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fastsplat.service.settings import Settings


def load_settings() -> Settings:
    """As `fastsplat.service.settings.load_settings`."""
    from fastsplat.service import settings

    return settings.load_settings()
