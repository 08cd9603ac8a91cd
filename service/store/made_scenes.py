"""What the job of a scene has made: drafts, then the scene itself, each with the edits that people made meanwhile."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from sqlalchemy import Connection, delete, insert, update

from fastsplat.service.store.name_repository import forget_names
from fastsplat.service.store.records import SceneSummary
from fastsplat.service.store.schema import scene_versions, scenes
from fastsplat.service.store.version_repository import (
    NewVersion,
    locked_scene,
    publish_within,
    trained_version,
    version_row,
    versions_of,
)
from fastsplat_contract.errors import ConflictError

_ROWS = scene_versions.c


def publish_made_within(
    connection: Connection,
    scene_id: str,
    summary: SceneSummary,
    carried: Sequence[NewVersion],
    *,
    edited: str,
    draft: bool,
) -> Sequence[str]:
    """Make what a job has made the scene's current version, with its edits, as a part of somebody's transaction.

    Drafts before a draft stay, for who has begun to look at them; a finished scene takes their place. Request ids are
    those of the edits that were made again.

    Args:
        connection: of the transaction.
        summary: of what was made.
        carried: versions that hold edits of the draft before, the first made of `summary.version`, each other one of
            the one before.
        edited: the edited version whose edits these are; "" for none.
        draft: whether it is a draft.

    Returns:
        The names of the versions that were removed, whose folders are the caller's to remove.

    Raises:
        ConflictError: the scene was edited meanwhile, or what was edited was undone.
        NotFoundError: the scene was deleted.
    """
    scene = locked_scene(connection, scene_id, "")
    records = versions_of(connection, scene_id)
    current = records.get(scene.version)
    if (current.version if current is not None and current.edits else "") != edited:
        raise ConflictError(f"the drafts of scene {scene_id!r} were edited meanwhile", field="version")
    if scene.version and not records:
        records = {scene.version: trained_version(scene)}
        if draft:
            connection.execute(insert(scene_versions).values(version_row(records[scene.version])))
    if draft and records:
        connection.execute(update(scene_versions).where(_ROWS.scene_id == scene_id).values(request_id=None))
    elif records:
        connection.execute(delete(scene_versions).where(_ROWS.scene_id == scene_id))
        forget_names(connection, scene_id)
    values: dict[str, Any] = {
        "version": summary.version, "gaussians": summary.gaussians, "scale": summary.scale,
        "dictionary": [dict(row) for row in summary.dictionary], "cameras": [dict(row) for row in summary.cameras],
        "quality": dict(summary.quality), "scaling": None, "alignment": None, "things": summary.things,
    }  # fmt: skip
    connection.execute(update(scenes).where(scenes.c.id == scene_id).values(values))
    if draft and records:
        row = version_row(trained_version(replace(scene, **values)))
        number = max(record.number for record in records.values()) + 1
        connection.execute(insert(scene_versions).values({**row, "number": number, "created_at": time.time()}))
    for new in carried:
        publish_within(connection, replace(new, max_versions=None))  # whatever was carried arrives
    return () if draft else sorted(records)
