"""Page tokens: opaque to clients (AIP-158)."""

from __future__ import annotations

import base64
import binascii
import hashlib
import json
import math
from bisect import bisect_right
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


def page_of(
    rows: Sequence[T], size: int, token: str, of: str, number: Callable[[T], int] | None = None
) -> tuple[Sequence[T], str]:
    """A page of a sequence, and the next token ("" after the last page).

    Args:
        of: names the sequence; tokens of other sequences raise `InvalidInputError`.
        number: of a row, ascending from 1, so that pages are stable while rows come and go; None: rows never change.
    """
    name, last = _digest(of), 0
    if token:
        match _read(token):
            case [int(last), str(said)] if said == name and (number is not None or 0 < last < len(rows)):
                pass
            case _:
                raise _unknown()
    numbers = range(1, len(rows) + 1) if number is None else list(map(number, rows))
    begin = bisect_right(numbers, last)
    end = begin + size
    return rows[begin:end], _write([numbers[end - 1], name]) if end < len(rows) else ""


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
