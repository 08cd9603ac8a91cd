"""Publication of drafts and finished scenes, with edits that people made meanwhile."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from sqlalchemy import Connection, delete, insert, update

from fastsplat.service.store.repositories.name_repository import forget_names
from fastsplat.service.store.repositories.version_repository import (
    NewVersion,
    locked_scene,
    publish_within,
    trained_version,
    version_row,
    versions_of,
)
from fastsplat.service.store.rows.records import SceneSummary
from fastsplat.service.store.rows.schema import scene_versions, scenes
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
    """Makes a job's result the scene's current version, with edits, within a transaction.

    Earlier drafts stay for those who look at them until the finished scene replaces them. Request ids move to the edits
    that were made again.

    Args:
        summary: of the result.
        carried: versions with the edits of the previous draft; the first is based on `summary.version`, each other one
            on the one before.
        edited: the edited version whose edits these are; "" for none.
        draft: the result is a draft.

    Returns:
        Names of the removed versions, whose folders the caller removes.

    Raises:
        ConflictError: the scene was edited meanwhile, or the edits were undone.
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
        publish_within(connection, replace(new, max_versions=None))  # no carried version is pruned
    return () if draft else sorted(records)
