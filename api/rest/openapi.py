"""Rewrites the committed `openapi.json`: `python -m fastsplat.api.rest.openapi`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, cast

from fastsplat.api.rest.app import create_app
from fastsplat.service.application.service import SceneService
from fastsplat.service.settings import Settings

COMMITTED = Path(__file__).with_name("openapi.json")


def describe() -> dict[str, Any]:
    """Generates the OpenAPI document; this needs no service."""
    return create_app(cast(SceneService, None), Settings()).openapi()


if __name__ == "__main__":
    COMMITTED.write_text(json.dumps(describe(), indent=1, sort_keys=True, ensure_ascii=False) + "\n")
