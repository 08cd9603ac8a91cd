"""Page tokens: opaque to clients, stable while scenes come and go (AIP-158)."""

from __future__ import annotations

import base64
import binascii
import json
import math

from service.common.errors import InvalidInputError


def write_page_token(created_at: float, scene_id: str) -> str:
    """The token that continues after this scene."""
    return base64.urlsafe_b64encode(json.dumps([created_at, scene_id]).encode()).decode().rstrip("=")


def read_page_token(token: str) -> tuple[float, str] | None:
    """What `write_page_token` wrote; None for "".

    Raises:
        InvalidInputError: no page returned this token.
    """
    if not token:
        return None
    try:
        created, scene_id = json.loads(base64.urlsafe_b64decode(token + "=" * (-len(token) % 4)))
        if isinstance(created, float) and math.isfinite(created) and isinstance(scene_id, str):
            return created, scene_id
    except (ValueError, TypeError, binascii.Error, RecursionError):
        pass
    raise InvalidInputError(
        "the page token is not one of this server's",
        field="page_token",
        hint="Leave it empty for the first page, then send back what the page before returned.",
    )
