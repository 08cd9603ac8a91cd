"""Records in `Scene.quality` which edits made a scene deviate from its photos."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fastsplat.service.scene.artefact.scene import Scene


def changed_views(quality: Mapping[str, Any]) -> tuple[str, ...]:
    """Lists the actions that made a version deviate from its photos, each once."""
    changes = quality.get("changed_by")
    return tuple(str(each) for each in changes) if isinstance(changes, (list, tuple)) else ()


def with_change(scene: Scene, action: str) -> Scene:
    """Records `action` in the scene's quality."""
    changes = changed_views(scene.quality)
    return scene if action in changes else replace(scene, quality={**scene.quality, "changed_by": [*changes, action]})
