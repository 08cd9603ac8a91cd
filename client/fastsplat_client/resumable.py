"""Resumable upload of one large file by the tus protocol 1.0.0: a connection that breaks costs one piece."""

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
    """The id of the upload that now holds the file.

    Args:
        transport: of the server.
        path: the file.
        retry: how often in a row a piece may fail.
        timeout_s: of one piece.
        piece_bytes: of one piece.

    Raises:
        FastSplatError: what the server has against it; a connection that breaks only after `retry.tries` in a row.
    """
    size = path.stat().st_size
    name = base64.b64encode(path.name.encode()).decode()
    headers = {**_TUS, "Upload-Length": str(size), "Upload-Metadata": f"filename {name}"}
    made = transport.call("POST", "/v1/uploads", headers=headers).headers["location"]
    upload_id = made.rpartition("/")[2]
    path_there = f"/v1/uploads/{upload_id}"  # below the transport's own address; `made` may begin with a proxy's path
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
    """Remove an upload ("" for none) if the block, which makes a scene of it, is told that none was made."""
    try:
        yield
    except FastSplatError as error:
        if upload_id and error.kind not in (Kind.UNAVAILABLE, Kind.DEADLINE_EXCEEDED):
            with suppress(FastSplatError):
                transport.call("DELETE", f"/v1/uploads/{upload_id}", headers=_TUS)
        raise


def _send(transport: Transport, location: str, offset: int, piece: bytes, timeout_s: float) -> int:
    """The offset after the piece, which the server has on disk."""
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
