"""Photos as they are uploaded, over both protocols."""

from __future__ import annotations

import base64
import struct
import zlib
from collections.abc import Iterator

import httpx
import numpy as np

from fastsplat.service.scene.formats.zips import zipped as zip_of
from fastsplat_contract.v1 import fastsplat_pb2 as pb
from tests.api.served import Faces
from tests.capture.upload_files import encoded

Files = list[tuple[str, bytes]]
TUS = {"Tus-Resumable": "1.0.0"}
PIECE = {**TUS, "Content-Type": "application/offset+octet-stream"}


def announced(name: str, length: int) -> dict[str, str]:
    """Headers that announce a file of tus."""
    encoded = base64.b64encode(name.encode()).decode()
    return {**TUS, "Upload-Length": str(length), "Upload-Metadata": f"filename {encoded}"}


def photo(seed: int, size: tuple[int, int] = (64, 48)) -> bytes:
    pixels = np.random.default_rng(seed).integers(0, 255, (size[1], size[0], 3), dtype=np.uint8)
    return encoded(pixels, "JPEG")


def photos(count: int) -> Files:
    return [(f"photo {number} ü.jpg", photo(number)) for number in range(count)]


def zipped(count: int, size: tuple[int, int] = (64, 48)) -> bytes:
    return zip_of({f"{number}.jpg": photo(number, size) for number in range(count)}, compressed=False)


def messages(files: Files, **header: object) -> Iterator[pb.CreateSceneRequest]:
    yield pb.CreateSceneRequest(header=pb.CreateSceneHeader(**header))
    for name, data in files:
        yield pb.CreateSceneRequest(file=pb.FileHeader(name=name, size_bytes=len(data)))
        for start in range(0, len(data), 1000):
            yield pb.CreateSceneRequest(chunk=data[start : start + 1000])


def post(faces: Faces, files: Files, data: dict[str, object] | None = None) -> httpx.Response:
    field = "capture" if len(files) == 1 else "images"
    return faces.rest.post("/v1/scenes", data=data or {}, files=[(field, file) for file in files])


def huge_png() -> bytes:
    """A PNG of a few bytes whose header says 30,000 by 30,000 pixels."""
    header = struct.pack(">IIBBBBB", 30_000, 30_000, 8, 2, 0, 0, 0)
    chunks = [(b"IHDR", header), (b"IDAT", zlib.compress(b"\0" * 1000)), (b"IEND", b"")]
    body = b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in chunks
    )
    return b"\x89PNG\r\n\x1a\n" + body
