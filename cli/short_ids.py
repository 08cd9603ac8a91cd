"""Ids in short, as in git: any beginning that only one of them has."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import islice

from fastsplat_contract.errors import InvalidInputError, NotFoundError

LEAST = 4
"""Letters of a beginning, at least."""
SHORT = 8
"""Letters of an id that tables show."""
_CANDIDATES = 5


def whole_id(noun: str, text: str, ids: Iterable[str]) -> str:
    """Completes the id that `text` begins; `NotFoundError` for none, `InvalidInputError` for several."""
    fitting = set()
    for full_id in ids:
        if full_id == text:
            return full_id
        if full_id.startswith(text):
            fitting.add(full_id)
    if not fitting:
        raise NotFoundError(f"no {noun} has the id {text[:80]!r}, or one that begins so", field=noun)
    if len(text) < LEAST:
        raise InvalidInputError(
            f"{text!r} is too short for the id of a {noun}", field=noun, limit=f"{LEAST} letters or more"
        )
    if len(fitting) > 1:
        named = ", ".join(islice(sorted(fitting), _CANDIDATES)) + (", ..." if len(fitting) > _CANDIDATES else "")
        raise InvalidInputError(
            f"{text!r} begins the ids of {len(fitting)} {noun}s", field=noun, hint=f"Type more letters of one: {named}"
        )
    return fitting.pop()
