"""Reads JSON files of uploads, bounded in size and depth."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat_contract.errors import InvalidInputError, LimitExceededError

_MAX_DEPTH = 32
_STRING = re.compile(r'"(?:[^"\\]|\\.)*"')
_BRACKET = re.compile(r"[\[\]{}]")


def read_json(path: Path, name: str, settings: CaptureSettings) -> Any:
    """Parses the JSON file `path`, called `name` in errors.

    Raises:
        InvalidInputError: not JSON, or nested too deeply.
        LimitExceededError: more than `max_json_bytes`.
    """
    if path.stat().st_size > settings.max_json_bytes:
        raise LimitExceededError.of(
            name,
            f"has {path.stat().st_size} bytes",
            "Send poses only, not measurements.",
            f"{settings.max_json_bytes} bytes",
        )
    try:
        text = path.read_text(encoding="utf-8-sig")
        if _depth(text) > _MAX_DEPTH:
            raise RecursionError
        return json.loads(text)
    except RecursionError as error:
        raise InvalidInputError.of(name, "is nested too deeply", "Flatten it.", f"{_MAX_DEPTH} levels") from error
    except ValueError as error:
        raise InvalidInputError.of(name, f"is not JSON: {error}", "Check it with a JSON tool.") from error


def _depth(text: str) -> int:
    """Measures the deepest nesting of brackets outside strings."""
    deepest = depth = 0
    for bracket in _BRACKET.findall(_STRING.sub("", text)):
        depth += 1 if bracket in "[{" else -1
        deepest = max(deepest, depth)
    return deepest
