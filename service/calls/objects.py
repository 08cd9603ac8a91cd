"""Things found in a scene, and edits to them, as callers see them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fastsplat.service.calls.types import Box, Pose, SceneObject, Vector

if TYPE_CHECKING:  # what finds objects loads with the first question for some
    from fastsplat.service.query.objects import SceneObject as FoundObject


def described(thing: FoundObject) -> SceneObject:
    """What a caller sees of a thing."""
    x, y, z, w = (float(value) for value in thing.box_orientation)
    return SceneObject(
        id=thing.id,
        label_id=thing.label_id,
        label=thing.label,
        score=float(thing.confidence),
        centroid=_vector(thing.centroid),
        box=Box(Pose(_vector(thing.box_center), (x, y, z, w)), _vector(thing.box_size)),
        gaussian_count=int(thing.gaussian_count),
        metres=thing.metres,
        best_views=tuple(thing.best_views),
    )


def _vector(values: object) -> Vector:
    x, y, z = (float(value) for value in values)  # type: ignore[attr-defined]
    return x, y, z
