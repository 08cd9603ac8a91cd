"""Immutable files over HTTP: ranges, ETags and conditional requests (RFC 9110, sections 13 and 14)."""

from __future__ import annotations

import re
from pathlib import Path

from starlette.requests import Request
from starlette.responses import FileResponse, Response

from fastsplat.api.rest.standard_http import not_modified
from fastsplat_contract.errors import RangeNotSatisfiableError

_RANGE = re.compile(r"bytes=\s*(?:\d+-\d*|-\d+)\s*(?:,\s*(?:\d+-\d*|-\d+)\s*)*", re.IGNORECASE)
_FIRST = re.compile(r"(\d+)-(\d*)|-(\d+)")


def immutable_file(request: Request, path: Path, media_type: str, filename: str, tag: str) -> Response:
    """Answers with a file, a range of it, or 304; `tag` identifies the content permanently.

    Raises:
        RangeNotSatisfiableError: the range lies outside the file.
    """
    etag = f'"{tag}"'
    headers = {"ETag": etag, "Cache-Control": "private, no-cache"}
    if (unchanged := not_modified(request, headers)) is not None:
        return unchanged
    size = path.stat().st_size
    range_header = request.headers.get("range")
    if range_header is not None and request.headers.get("if-range", etag) == etag:
        if not _RANGE.fullmatch(range_header) or not _consistent(range_header):
            # RFC 9110: an invalid Range is ignored.
            request.scope["headers"] = [header for header in request.scope["headers"] if header[0] != b"range"]
        elif not _within(range_header, size):
            raise RangeNotSatisfiableError(
                f"no byte of {range_header[:80]!r} is in a file of {size} bytes", field="Range", limit=f"{size} bytes"
            )
    return FileResponse(path, media_type=media_type, filename=filename, headers=headers)


def _consistent(header: str) -> bool:
    return all(not last or int(first) <= int(last) for first, last, _ in _FIRST.findall(header) if first)


def _within(header: str, size: int) -> bool:
    return any(
        int(first) < size if first else int(suffix) > 0 and size > 0 for first, _, suffix in _FIRST.findall(header)
    )
