"""What edits have made a scene show that its photos do not: it stands in `Scene.quality`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fastsplat.service.scene.types import Scene


def changed_views(quality: Mapping[str, Any]) -> tuple[str, ...]:
    """The actions by which a version came to show what its photos do not, each once."""
    changes = quality.get("changed_by")
    return tuple(str(each) for each in changes) if isinstance(changes, (list, tuple)) else ()


def with_change(scene: Scene, action: str) -> Scene:
    """The scene, in which `action` is noted as one of these."""
    changes = changed_views(scene.quality)
    return scene if action in changes else replace(scene, quality={**scene.quality, "changed_by": [*changes, action]})
