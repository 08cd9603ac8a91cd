"""Examples of what those see who run a place: its keys and the names that it knows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

from fastsplat_contract.keys import AccessKey, KeyIn, KeyList, LifetimeIn, NewKey
from fastsplat_contract.known_names import KnownName, KnownNameList

_MADE = datetime(2026, 1, 1, 12, 0, tzinfo=UTC)


def admin_answers(ids: Mapping[str, str], page_token: str) -> Sequence[Any]:
    """Answers about keys and known names, of things with these ids."""
    key = AccessKey(
        id=ids["key_id"],
        name="robot in the kitchen",
        project="default",
        role="reader",
        state="VALID",
        created_at=_MADE,
        expires_at=datetime(2027, 1, 1, 12, 0, tzinfo=UTC),
        revoked_at=None,
    )
    known_name = KnownName(
        id=ids["name_id"],
        name="mug",
        scene_id=ids["scene_id"],
        version=ids["version"],
        thing_id=1,
        named_at=_MADE,
        picture=b"\xff\xd8\xff",
    )
    return (
        key,
        NewKey(key, f"fsk_{key.id}_is-43-letters-digits-hyphens-or-underscores"),
        KeyList((key,), page_token),
        KnownNameList((known_name,), page_token),
    )


ADMIN_BODIES: Mapping[str, Mapping[str, tuple[str, Any]]] = {
    "KeyIn": {
        "robot": ("a key for a year that only looks", KeyIn("robot in the kitchen", "reader", 31_536_000.0)),
        "person": ("a key that also creates and changes", KeyIn("Ada")),
    },
    "LifetimeIn": {"hour": ("one hour more", LifetimeIn(3_600.0))},
}
"""Bodies by the name of their type, as `examples.BODIES`."""
