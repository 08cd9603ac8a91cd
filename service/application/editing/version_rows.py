"""Database rows of versions and their edits."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Any

from fastsplat.service.application.base.validate import check_texts
from fastsplat.service.store.repositories.version_repository import VersionRecord
from fastsplat.service.store.rows.damaged_rows import decodes
from fastsplat_contract.codec.json_codec import from_plain, to_plain
from fastsplat_contract.errors import InvalidInputError, LimitExceededError
from fastsplat_contract.geometry.object_prompts import PromptedObject
from fastsplat_contract.messages.scenes import Edit, SceneVersion

_MAX_EDITS = 100
"""Limit of edits in one request."""

PROMPTED = "prompted"
"""Key in an edit's row: the result of its prompt."""
ASKS_KIND = "asks_kind"
"""Key in an edit's row: true if it gave a name without any known word."""
_BESIDE = (PROMPTED, ASKS_KIND)


def check_edits(edits: Sequence[Edit]) -> list[dict[str, Any]]:
    """Converts edits to JSON, rejecting any that could not be read back.

    Raises:
        InvalidInputError: no edits, or one with an invalid value.
        LimitExceededError: too many edits.
    """
    check_texts(tuple(edits), "edits")
    if not edits:
        raise InvalidInputError("no edits", field="edits", hint="Send at least one.")
    if len(edits) > _MAX_EDITS:
        raise LimitExceededError(
            f"{len(edits)} edits", field="edits", limit=f"{_MAX_EDITS} edits", hint="Send them in several requests."
        )
    rows = [to_plain(edit) for edit in edits]
    for number, row in enumerate(rows):
        from_plain(Edit, row, f"edits[{number}]")
    return rows


@decodes("version")
def version_of(record: VersionRecord) -> SceneVersion:
    """Converts a version row for callers."""
    return SceneVersion(
        scene_id=record.scene_id,
        version=record.version,
        parent=record.parent,
        created_at=datetime.fromtimestamp(record.created_at, UTC),
        gaussians=record.gaussians,
        current=record.current,
        edits=tuple(from_plain(Edit, {n: row[n] for n in row if n not in _BESIDE}) for row in record.edits),
        prompted=tuple(from_plain(PromptedObject, row[PROMPTED]) for row in record.edits if PROMPTED in row),
        author=record.author,
        asks_kind=any(ASKS_KIND in row for row in record.edits),
    )
