"""Drafts: scene versions that can be queried while their job is still running.

A draft is marked in its quality, so that answers from it and from its edits can say so.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from fastsplat.service.scene.artefact.scene import Scene
from fastsplat_contract.jobs.job_watching import Provisional

_DRAFT = "draft"

DRAFTS = (Provisional("points", 0.0), Provisional("training", 0.25))
"""Drafts that a job publishes, in order."""


def draft_of(scene: Scene, provisional: Provisional) -> Scene:
    return replace(scene, quality={**scene.quality, _DRAFT: provisional._asdict()})


def provisional_of(quality: Mapping[str, Any]) -> Provisional | None:
    """Returns the draft's mark; None for a finished scene."""
    draft = quality.get(_DRAFT)
    return Provisional(**draft) if isinstance(draft, Mapping) else None
