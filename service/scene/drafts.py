"""Drafts: versions of a scene that can be asked while its job still makes it.

What one is made of stands in its quality, so that all answers from it, and from what it was edited to, can say so.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from fastsplat.service.scene.types import Scene
from fastsplat_contract.job_watching import Provisional

_DRAFT = "draft"

DRAFTS = (Provisional("points", 0.0), Provisional("training", 0.25))
"""Those that a job publishes, in order."""


def draft_of(scene: Scene, provisional: Provisional) -> Scene:
    """The scene as a draft."""
    return replace(scene, quality={**scene.quality, _DRAFT: provisional._asdict()})


def provisional_of(quality: Mapping[str, Any]) -> Provisional | None:
    """What the draft with this quality is made of; None of a finished scene."""
    draft = quality.get(_DRAFT)
    return Provisional(**draft) if isinstance(draft, Mapping) else None
