"""Photo verdicts: written by the worker that captures the scene, read with the scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from sqlalchemy import Connection, Engine, delete, insert, select

from fastsplat.service.store.rows.damaged_rows import are_objects, require
from fastsplat.service.store.rows.database import transaction
from fastsplat.service.store.rows.schema import scene_photos, scenes


def record_photos(connection: Connection, scene_id: str, photos: Sequence[Mapping[str, Any]]) -> None:
    """Replaces the photo verdicts (JSON objects) of a scene; does nothing if it was deleted."""
    forget_photos(connection, scene_id)
    if connection.scalar(select(scenes.c.id).where(scenes.c.id == scene_id)) is not None:
        connection.execute(insert(scene_photos).values(scene_id=scene_id, photos=[dict(photo) for photo in photos]))


def forget_photos(connection: Connection, scene_id: str) -> None:
    connection.execute(delete(scene_photos).where(scene_photos.c.scene_id == scene_id))


class PhotoRepository:
    """Photo verdicts; each method is one transaction and may raise `DatabaseError`."""

    def __init__(self, engine: Engine) -> None:
        self._reading = partial(transaction, engine.execution_options(read_only=True))

    def of_scene(self, scene_id: str) -> Sequence[Mapping[str, Any]]:
        """Returns a scene's verdicts, [] if there are none; does not check the scene's project."""
        query = select(scene_photos.c.photos).where(scene_photos.c.scene_id == scene_id)
        with self._reading() as connection:
            photos = connection.scalar(query)
        return [] if photos is None else read_verdicts({"scene_id": scene_id, "photos": photos})


def read_verdicts(row: Mapping[Any, Any]) -> Sequence[Mapping[str, Any]]:
    """Returns the verdicts of a row; raises `ArtefactError` if they cannot be read."""
    photos: Sequence[Mapping[str, Any]] = row["photos"]
    require(f"photos of scene {row['scene_id']}", photos=are_objects(photos, "name", "placed"))
    return photos
