"""Examples of what those see who run a place: its keys and the names that it knows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

from fastsplat_contract.keys import AccessKey, KeyIn, KeyList, LifetimeIn, NewKey, UploadKeyIn
from fastsplat_contract.known_names import KnownName, KnownNameList
from fastsplat_contract.server_status import ModelStatus, QuotaStatus, ServerStatus

_MADE = datetime(2026, 1, 1, 12, 0, tzinfo=UTC)


_STATUS = ServerStatus(
    version="0.1.0",
    project="default",
    role="editor",
    key_expires_at=None,
    upload_operation="",
    models=(
        ModelStatus("text_encoder", "minilm_l6_int8", "ready", calibrated=True),
        ModelStatus("open_set_detector", "", "unset", calibrated=None),
    ),
    backend="cpu",
    training_backend="cuda",
    workers=2,
    quotas=(QuotaStatus("scenes", 12, 1_000), QuotaStatus("bytes", 3_000_000_000, None), QuotaStatus("jobs", 1, 100)),
    max_upload_bytes=10_000_000_000,
    max_images=2_000,
    addresses=("http://192.168.1.20:8000/",),
)


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
        _STATUS,
    )


ADMIN_BODIES: Mapping[str, Mapping[str, tuple[str, Any]]] = {
    "KeyIn": {
        "robot": ("a key for a year that only looks", KeyIn("robot in the kitchen", "reader", 31_536_000.0)),
        "person": ("a key that also creates and changes", KeyIn("Ada")),
    },
    "UploadKeyIn": {"default": ("a link for one's phone", UploadKeyIn())},
    "LifetimeIn": {"hour": ("one hour more", LifetimeIn(3_600.0))},
}
"""Bodies by the name of their type, as `examples.BODIES`."""
