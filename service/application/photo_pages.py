"""Pages of what became of a scene's photos."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from fastsplat.service.application.paging import page_of
from fastsplat_contract.json_codec import from_plain
from fastsplat_contract.photo_verdicts import PhotoVerdict, PhotoVerdictList


def photo_page(rows: Sequence[Mapping[str, Any]], size: int, page_token: str, scene_id: str) -> PhotoVerdictList:
    """At most `size` of the stored verdicts of a scene's photos, those that the token names.

    Raises:
        InvalidInputError: a token that no page returned.
    """
    placed = sum(bool(row["placed"]) for row in rows)
    page, token = page_of(rows, size, page_token, f"photos {scene_id} {len(rows)}")
    photos = tuple(from_plain(PhotoVerdict, dict(row)) for row in page)
    return PhotoVerdictList(photos, token, bool(rows), placed, len(rows))
