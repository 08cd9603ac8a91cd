"""Pages of photo verdicts of a scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from fastsplat.service.application.base.paging import page_of
from fastsplat_contract.json_codec import from_plain
from fastsplat_contract.photo_verdicts import PhotoVerdict, PhotoVerdictList


def photo_page(
    rows: Sequence[Mapping[str, Any]], quality: Mapping[str, Any], size: int, page_token: str, scene_id: str
) -> PhotoVerdictList:
    """At most `size` of the stored verdicts of a scene's photos, those that the token names, with what its training
    estimated of them (`photometric` of its quality).

    Raises:
        InvalidInputError: a token that no page returned.
    """
    placed = sum(bool(row["placed"]) for row in rows)
    page, token = page_of(rows, size, page_token, f"photos {scene_id} {len(rows)}")
    corrections = quality.get("photometric", {})
    photos = tuple(_verdict(row, corrections.get(row["name"])) for row in page)
    return PhotoVerdictList(photos, token, bool(rows), placed, len(rows))


def _verdict(row: Mapping[str, Any], correction: Sequence[float] | None) -> PhotoVerdict:
    verdict = from_plain(PhotoVerdict, dict(row))
    if correction is None:
        return verdict
    exposure_ev, red_ev, blue_ev = correction
    return replace(verdict, exposure_ev=exposure_ev, red_ev=red_ev, blue_ev=blue_ev)
