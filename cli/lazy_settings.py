"""The settings, which load with the first command that needs them: they are a third of what a mere `--help` loads."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fastsplat.service.settings import Settings


def load_settings() -> Settings:
    """As `fastsplat.service.settings.load_settings`."""
    from fastsplat.service import settings

    return settings.load_settings()
