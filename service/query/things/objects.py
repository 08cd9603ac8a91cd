"""Objects, as earlier releases have them: the things that bear a name, under the label of that name."""

from __future__ import annotations

from collections.abc import Sequence

from fastsplat.service.query.things.thing_index import SceneThings
from fastsplat_contract.errors import NotFoundError
from fastsplat_contract.scenes import SceneObject
from fastsplat_contract.thing_messages import SceneThing


def objects_of(things: SceneThings) -> tuple[SceneObject, ...]:
    """The things and parts of a scene that have a name and can be seen, by label id, then from the largest: what
    `SceneThings` says of them, and no more. An object's id is "label id-number", numbered from the largest."""
    labeled: dict[int, list[SceneThing]] = {}
    for thing in (*things.listed, *things.listed_parts):
        if thing.name and thing.box is not None and (label_id := things.scene.dictionary.id_of(thing.name)):
            labeled.setdefault(label_id, []).append(thing)
    views = things.best_views([thing.id for own in labeled.values() for thing in own])
    objects = []
    for label_id, own in sorted(labeled.items()):
        own.sort(key=lambda thing: -things.extents[thing.id].opacity)
        objects += [
            _object(thing, label_id, number, views.get(thing.id, ())) for number, thing in enumerate(own, start=1)
        ]
    return tuple(objects)


def thing_of_object(objects: Sequence[SceneObject], object_id: str) -> int:
    """The id of the thing that an object is.

    Raises:
        NotFoundError: there is no such object.
    """
    for each in objects:
        if each.id == object_id:
            return each.thing_id
    raise NotFoundError(
        f"no object {object_id[:80]!r} in this scene", field="object_id", hint="List the scene's objects."
    )


def _object(thing: SceneThing, label_id: int, number: int, best_views: tuple[str, ...]) -> SceneObject:
    assert thing.box is not None and thing.centroid is not None
    return SceneObject(
        id=f"{label_id}-{number}",
        label_id=label_id,
        label=thing.name,
        score=thing.probability,
        centroid=thing.centroid,
        box=thing.box,
        gaussian_count=thing.gaussian_count,
        meters=thing.meters,
        best_views=best_views,
        thing_id=thing.id,
    )
