"""Resumable upload of a large file by tus 1.0.0; a broken connection costs one piece."""

from __future__ import annotations

import base64
import hashlib
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from fastsplat_client.errors import UnreachableError
from fastsplat_client.transport import Retry, Transport
from fastsplat_contract.errors import DeadlineExceededError, FastSplatError, Kind

PIECE_BYTES = 8 << 20

_TUS = {"Tus-Resumable": "1.0.0"}


def send_resumable(transport: Transport, path: Path, retry: Retry, timeout_s: float, piece_bytes: int) -> str:
    """Uploads a file in pieces, each within `timeout_s`, and returns the upload's id.

    Raises:
        FastSplatError: the server's error, or that of a connection after `retry.tries` failures in a row.
    """
    size = path.stat().st_size
    name = base64.b64encode(path.name.encode()).decode()
    headers = {**_TUS, "Upload-Length": str(size), "Upload-Metadata": f"filename {name}"}
    location = transport.call("POST", "/v1/uploads", headers=headers).headers["location"]
    upload_id = location.rpartition("/")[2]
    path_there = f"/v1/uploads/{upload_id}"  # not the header, which may begin with a proxy's path
    offset = failures = 0
    with path.open("rb") as file:
        while offset < size:
            file.seek(offset)
            try:
                offset = _send(transport, path_there, offset, file.read(piece_bytes), timeout_s)
                failures = 0
            except FastSplatError as error:
                lost = isinstance(error, UnreachableError | DeadlineExceededError) or error.kind is Kind.UNAVAILABLE
                failures += 1
                if not lost or failures >= retry.tries:
                    raise
                time.sleep(retry.pause(failures - 1))
                offset = int(transport.call("HEAD", path_there, headers=_TUS).headers["upload-offset"])
    return upload_id


@contextmanager
def dropped_if_refused(transport: Transport, upload_id: str) -> Iterator[None]:
    """Deletes an upload ("": none) if the server refuses the block's request."""
    try:
        yield
    except FastSplatError as error:
        if upload_id and error.kind not in (Kind.UNAVAILABLE, Kind.DEADLINE_EXCEEDED):
            with suppress(FastSplatError):
                transport.call("DELETE", f"/v1/uploads/{upload_id}", headers=_TUS)
        raise


def _send(transport: Transport, location: str, offset: int, piece: bytes, timeout_s: float) -> int:
    """Sends a piece and returns the durable offset after it."""
    headers = {
        **_TUS,
        "Content-Type": "application/offset+octet-stream",
        "Upload-Offset": str(offset),
        "Upload-Checksum": f"sha256 {base64.b64encode(hashlib.sha256(piece).digest()).decode()}",
    }
    response = transport.call(
        "PATCH", location, content=lambda: {"content": piece}, headers=headers, repeatable=False, timeout_s=timeout_s
    )
    return int(response.headers["upload-offset"])
