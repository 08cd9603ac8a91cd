"""Page tokens: opaque to clients (AIP-158)."""

from __future__ import annotations

import base64
import binascii
import hashlib
import json
import math
from collections.abc import Callable, Sequence
from typing import TypeVar

from fastsplat_contract.errors import InvalidInputError

T = TypeVar("T")


def write_page_token(created_at: float, row_id: str) -> str:
    """Token of the page after this row; stable while rows come and go."""
    return _write([created_at, row_id])


def read_page_token(token: str) -> tuple[float, str] | None:
    """Reads `write_page_token`; None for "". Raises `InvalidInputError` for an unknown token."""
    if not token:
        return None
    match _read(token):
        case [float(created), str(row_id)] if math.isfinite(created):
            return created, row_id
    raise _unknown()


def page_of(rows: Sequence[T], size: int, token: str, of: str) -> tuple[Sequence[T], str]:
    """A page of an immutable sequence, and the next token ("" after the last page).

    `of` names the sequence; tokens of other sequences raise `InvalidInputError`.
    """
    name = _digest(of)
    start = 0
    if token:
        match _read(token):
            case [int(start), str(said)] if said == name and 0 < start < len(rows):
                pass
            case _:
                raise _unknown()
    end = start + size
    return rows[start:end], _write([end, name]) if end < len(rows) else ""


def page_after(
    rows: Sequence[T], number: Callable[[T], int], size: int, token: str, of: str
) -> tuple[Sequence[T], str]:
    """A page of rows sorted by unique numbers (from 1), and the next token.

    Stable while rows come and go; `of` and errors as in `page_of`.
    """
    last = 0
    if token:
        match _read(token):
            case [int(last), str(said)] if said == _digest(of):
                pass
            case _:
                raise _unknown()
    left = [row for row in rows if number(row) > last]
    page = left[:size]
    return page, _write([number(page[-1]), _digest(of)]) if len(left) > size else ""


def _digest(of: str) -> str:
    return hashlib.sha256(of.encode(errors="replace")).hexdigest()[:16]


def _write(value: object) -> str:
    return base64.urlsafe_b64encode(json.dumps(value).encode()).decode().rstrip("=")


def _read(token: str) -> object:
    try:
        return json.loads(base64.urlsafe_b64decode(token + "=" * (-len(token) % 4)))
    except (ValueError, TypeError, binascii.Error, RecursionError):
        return None


def _unknown() -> InvalidInputError:
    return InvalidInputError(
        "the page token is not one of this server's",
        field="page_token",
        hint="Leave it empty for the first page, then send back what the page before returned.",
    )
