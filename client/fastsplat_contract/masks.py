"""Masks as text and bytes: COCO run lengths for images, packed bits, runs or row numbers for Gaussians."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from io import BytesIO
from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from fastsplat_contract.codec.wire import Base64, Int64, Many, Response
from fastsplat_contract.errors import InvalidInputError, MissingPackageError

MaskEncoding = Literal["rle", "png"]
Mask3dEncoding = Literal["bits", "runs", "indices", "ply"]

_MAX_PIXELS = 1 << 28
_U32 = np.dtype("<u4")


@dataclass(frozen=True)
class Segmentation(Response):
    """COCO run-length encoding: column-major, background first, ascii counts."""

    size: Annotated[Many[int], Field(min_length=2, max_length=2, description="height, width in pixels")]
    counts: str

    def array(self) -> NDArray[np.bool_]:
        """bool [H, W].

        Examples:
            >>> Segmentation((2, 2), "22").array()
            array([[False,  True],
                   [False,  True]])
        """
        height, width = self.size
        return decode_rle(self.counts, height, width)


@dataclass(frozen=True)
class ViewMask(Response):
    """A 2D mask of one answer in one camera."""

    view: Annotated[str, Field(description="the scene's camera, or empty for a free viewpoint")]
    camera_index: Annotated[int, Field(description="which of the request's cameras; meaningless when `view` is set")]
    segmentation: Annotated[Segmentation | None, Field(description="absent if PNG was asked for")]
    png: Annotated[
        Base64 | None,
        Field(description="8-bit gray PNG, 255 inside, 0 outside, base64 in JSON; absent unless asked for"),
    ]
    area: Annotated[Int64, Field(description="pixels inside")]

    def array(self) -> NDArray[np.bool_]:
        """bool [H, W].

        Raises:
            InvalidInputError: there is no mask in it, or not of its size.
            MissingPackageError: it came as PNG, and Pillow is not installed.
        """
        if self.segmentation is not None:
            return self.segmentation.array()
        if self.png is None:
            raise _bad("neither run lengths nor a PNG")
        try:
            image = importlib.import_module("PIL.Image")
        except ImportError:
            raise MissingPackageError(
                "PNG masks need Pillow",
                field="mask2d_encoding",
                hint="pip install 'fastsplat-client[png]', or ask for \"rle\".",
            ) from None
        return np.asarray(image.open(BytesIO(self.png))) > 0


@dataclass(frozen=True)
class ViewMaskPiece(ViewMask):
    """A 2D mask as it travels over gRPC: whole, or the rest of one that is too long for one message."""

    proto: ClassVar[str] = "ViewMask"

    continues: Annotated[
        bool, Field(description="append this one's counts or png to those of the mask before; nothing else is new")
    ] = False


def encode_rle(mask: NDArray[np.bool_]) -> str:
    """COCO's ascii counts of a bool [H, W] mask.

    Runs go down the columns and begin with background. From the fourth run on, a run is written as its difference to
    the run two before; numbers are little-endian base 32 with a continuation bit, from character 48 on. This is the
    `counts` of pycocotools (rleToString in its maskApi.c); `size` is [H, W].
    """
    runs = _runs(mask)
    letters: list[str] = []
    for index, run in enumerate(runs):
        number = run - runs[index - 2] if index > 2 else run
        more = True
        while more:
            digit = number & 0x1F
            number >>= 5
            more = number != -1 if digit & 0x10 else number != 0
            letters.append(chr((digit | 0x20 if more else digit) + 48))
    return "".join(letters)


def decode_rle(counts: str, height: int, width: int) -> NDArray[np.bool_]:
    """Decodes COCO's ascii counts to bool [H, W]; `InvalidInputError` for a bad size, letter or run."""
    if height < 0 or width < 0 or height * width > _MAX_PIXELS:
        raise _bad(f"a mask of {height}×{width} pixels", limit=f"{_MAX_PIXELS} pixels")
    runs: list[int] = []
    number, shift = 0, 0
    for letter in counts:
        code = ord(letter) - 48
        if not 0 <= code < 64 or shift > 35:
            raise _bad(f"run-length counts with {letter!r} at number {len(runs)}")
        number |= (code & 0x1F) << shift
        shift += 5
        if code & 0x20:
            continue
        if code & 0x10:
            number -= 1 << shift
        run = number + runs[-2] if len(runs) > 2 else number
        if not 0 <= run <= height * width:
            raise _bad(f"a run of {run} pixels in a mask of {height}×{width}")
        runs.append(run)
        number, shift = 0, 0
    if shift or sum(runs) != height * width:
        raise _bad(f"run-length counts of {sum(runs)} pixels for a mask of {height}×{width}")
    values = np.arange(len(runs)) % 2 == 1
    return np.repeat(values, runs).reshape(width, height).T


def pack_bits(mask: NDArray[np.bool_]) -> bytes:
    """A bool [G] mask as ceil(G / 8) bytes, most significant bit first, the last byte filled with zeros."""
    return np.packbits(mask).tobytes()


def unpack_bits(data: bytes, count: int) -> NDArray[np.bool_]:
    """Unpacks bits to bool [count]; `InvalidInputError` for a wrong number of bytes, or bits in the filling."""
    bits = np.unpackbits(np.frombuffer(data, dtype=np.uint8))
    if count < 0 or len(data) != -(-count // 8) or bits[count:].any():
        raise _bad(f"{len(data)} bytes of packed bits for {count} Gaussians")
    return np.asarray(bits[:count].astype(np.bool_))


def decode_mask3d(data: bytes, encoding: Mask3dEncoding, count: int) -> NDArray[np.bool_]:
    """bool [count] of "bits", "runs" or "indices".

    Examples:
        >>> decode_mask3d(bytes([0b01100000]), "bits", 4)
        array([False,  True,  True, False])

    Raises:
        InvalidInputError: the bytes do not describe `count` Gaussians, or are a PLY, which does not say the rows.
    """
    if encoding == "bits":
        return unpack_bits(data, count)
    if encoding == "ply" or len(data) % _U32.itemsize:
        raise InvalidInputError(f"{len(data)} bytes are no mask as {encoding}", field="mask3d")
    numbers = np.frombuffer(data, dtype=_U32).astype(np.int64)
    if encoding == "runs":
        if numbers.sum() != count:
            raise InvalidInputError(f"runs over {numbers.sum()} Gaussians, not {count}", field="mask3d")
        return np.repeat(np.arange(len(numbers)) % 2 == 1, numbers)
    if len(numbers) and (numbers.max() >= count or (np.diff(numbers) <= 0).any()):
        raise InvalidInputError(f"row numbers that do not ascend below {count}", field="mask3d")
    mask = np.zeros(count, dtype=np.bool_)
    mask[numbers] = True
    return mask


def pack_mask3d(mask: NDArray[np.bool_], encoding: Mask3dEncoding) -> bytes:
    """A bool [G] mask as "bits", "runs" or "indices"; what `decode_mask3d` reads.

    Raises:
        InvalidInputError: "ply", which is made of the Gaussians and not of the mask.
    """
    if encoding == "bits":
        return pack_bits(mask)
    if encoding == "indices":
        return np.flatnonzero(mask).astype(_U32).tobytes()
    if encoding == "runs":
        edges = np.flatnonzero(np.diff(mask.astype(np.int8), prepend=0, append=2)) if len(mask) else np.zeros(0)
        return np.diff(edges, prepend=0).astype(_U32).tobytes()
    raise InvalidInputError(f"a mask has no encoding as {encoding}", field="mask3d_encoding")


def _runs(mask: NDArray[np.bool_]) -> list[int]:
    """Lengths of the alternating runs down the columns, background first (a length of 0 if the first pixel is set)."""
    flat = np.asarray(mask, dtype=np.bool_).reshape(-1, order="F")
    if not len(flat):
        return []
    edges = np.flatnonzero(flat[1:] != flat[:-1]) + 1
    bounds = np.concatenate([[0], edges, [len(flat)]])
    runs: list[int] = np.diff(bounds).tolist()
    return [0, *runs] if flat[0] else runs


def _bad(message: str, limit: str = "") -> InvalidInputError:
    return InvalidInputError(message, field="mask", limit=limit, hint="Send COCO RLE counts that match the size.")
