"""The choice of models: what API and workers use in each role, unless their settings name another."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypedDict


class ChosenModel(TypedDict):
    """A model in use: its name as in a setting, and hex SHA-256 by file."""

    name: str
    sha256: dict[str, str]


ModelChoice = Mapping[str, ChosenModel]
"""Chosen models by role; roles that are absent have the settings' models."""
