"""Unpacks LZFSE (https://github.com/lzfse/lzfse) within bounded memory.

The decoder doubles its memory for as long as a stream asks, so block sizes are added up first.
"""

from __future__ import annotations

import struct

from fastsplat.service.common.optional_packages import LZFSE, needed
from fastsplat_contract.errors import CorruptImageError

_END, _PLAIN, _LZFSE, _LZVN = b"bvx$", b"bvx-", b"bvx2", b"bvxn"
_HINT = "Export the recording again."
_PAYLOAD_BITS = (1 << 20) - 1


def unpack_lzfse(packed: bytes, name: str, expected_bytes: int) -> bytes:
    """Unpacks exactly `expected_bytes`; errors name the file `name`.

    Raises:
        CorruptImageError: cut short, damaged, no LZFSE, or of another size.
        MissingPackageError: the decoder's package is not installed.
    """
    size = _unpacked_bytes(packed)
    if size is None:
        raise CorruptImageError(f"{name} is cut short or damaged", field=name, hint=_HINT)
    if size != expected_bytes:
        raise _wrong_size(name, size, expected_bytes)
    with needed(LZFSE, "the depth of Record3D's recordings", name):
        import lzfse

    try:
        content = bytes(lzfse.decompress(packed))
    except (lzfse.error, MemoryError) as error:  # on damaged content it asks for ever more memory
        raise CorruptImageError(f"{name} is damaged: {error}", field=name, hint=_HINT) from error
    if len(content) != expected_bytes:
        raise _wrong_size(name, len(content), expected_bytes)
    return content


def _unpacked_bytes(packed: bytes) -> int | None:
    """Adds up the sizes in block headers; None if the stream ends early."""
    at, total = 0, 0
    while True:
        kind = packed[at : at + 4]
        if kind == _END:
            return total
        header = packed[at : at + 32]
        if len(header) < 12:
            return None
        raw = struct.unpack_from("<I", header, 4)[0]
        total += raw
        if kind == _PLAIN:
            at += 8 + raw
        elif kind == _LZVN:
            at += 12 + struct.unpack_from("<I", header, 8)[0]
        elif kind == _LZFSE and len(header) == 32:
            literals, matches, sizes = struct.unpack_from("<3Q", header, 8)
            payload = (literals >> 20 & _PAYLOAD_BITS) + (matches >> 40 & _PAYLOAD_BITS)
            at += max(32, sizes & 0xFFFFFFFF) + payload
        else:
            return None


def _wrong_size(name: str, size: int, expected_bytes: int) -> CorruptImageError:
    return CorruptImageError.of(
        name, f"unpacks to {size} bytes", _HINT, f"{expected_bytes} bytes, by the size in the metadata"
    )
