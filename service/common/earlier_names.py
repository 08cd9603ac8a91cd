"""Names of JSON fields that earlier versions stored, as they are called now."""

from __future__ import annotations

from typing import Any

_NOW = {"thing": "object_id", "thing_id": "object_id", "things": "object_ids", "shown": "objects"}


def renamed_keys(stored: Any) -> Any:
    """Copies a JSON value without keys of users' choice, with its fields' present names: an object was a thing."""
    if isinstance(stored, list):
        return [renamed_keys(value) for value in stored]
    if not isinstance(stored, dict):
        return stored
    return {_NOW.get(key, key): renamed_keys(value) for key, value in stored.items()}
