"""Names of JSON fields that earlier versions stored, as they are called now."""

from __future__ import annotations

from typing import Any


def renamed_keys(stored: Any) -> Any:
    """Copies a JSON value with its fields' present names: an object was a thing, a captioner a namer."""
    if stored == "NAMER_FAILED":
        return "CAPTIONER_FAILED"
    if isinstance(stored, list):
        return [renamed_keys(value) for value in stored]
    if not isinstance(stored, dict):
        return stored
    return {_name(key, value): renamed_keys(value) for key, value in stored.items()}


def _name(key: str, value: Any) -> str:
    if key == "things":
        return "object_ids" if isinstance(value, list) else "objects"
    return "object_id" if key in ("thing", "thing_id") else key
