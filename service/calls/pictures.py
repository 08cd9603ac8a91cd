"""One view of a scene as a picture or as an array file."""

from __future__ import annotations

from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, PngImagePlugin

from fastsplat.service.calls.types import PictureFormat, PictureKind
from fastsplat.service.common.camera import PosedCamera
from fastsplat.service.common.errors import InvalidInputError
from fastsplat.service.query import SceneIndex, pictures
from fastsplat.service.query.query_text import TextQuery

KINDS: tuple[PictureKind, ...] = ("rgb", "overlay", "relevancy", "mask", "label_map", "depth", "depth_picture")
ASKING: tuple[PictureKind, ...] = ("overlay", "relevancy", "mask")
"""Kinds that show the answer to a text."""
_ARRAYS = ("label_map", "depth")
DEPTH_SCALE = 0.001
_FARTHEST = 65_535


def check_picture(kind: str, text: str | None, image_format: str, depth_scale: float) -> None:
    """Raise unless such a picture can be made.

    Raises:
        InvalidInputError: an unknown kind, a missing text, numpy's format for what is a picture, a scale that is none.
    """
    if kind not in KINDS:
        named = ", ".join(f'"{known}"' for known in KINDS)
        raise InvalidInputError(f"no picture of kind {kind[:40]!r}", field="kind", hint=f"Use one of {named}.")
    if kind in ASKING and text is None:
        raise InvalidInputError(f'a picture of kind "{kind}" needs a text', field="text")
    if image_format == "npy" and kind not in _ARRAYS:
        raise InvalidInputError(
            f'"{kind}" is a picture, not an array', field="format", hint='Use "png", or ask for label_map or depth.'
        )
    if not (np.isfinite(depth_scale) and depth_scale >= 0):
        raise InvalidInputError(
            f"a depth scale of {depth_scale}", field="depth_scale", hint="Scene units a step, above 0; 0.001 is usual."
        )


def picture(
    index: SceneIndex,
    kind: PictureKind,
    query: TextQuery | None,
    posed: PosedCamera,
    image_format: PictureFormat = "png",
    depth_scale: float = 0.0,
) -> bytes:
    """The bytes of one picture; the arguments have passed `check_picture`."""
    if kind == "rgb":
        return pictures.png_bytes(index.render(posed))
    if kind == "label_map":
        labels = index.label_map(posed)
        return _npy(labels) if image_format == "npy" else _png16(labels)
    if kind in ("depth", "depth_picture"):
        depth = index.depth(posed)
        if kind == "depth_picture":
            return pictures.png_bytes(_depth_picture(depth))
        return _npy(depth) if image_format == "npy" else _depth_png(depth, depth_scale or DEPTH_SCALE)
    assert query is not None
    (answer,) = index.answer(query)
    seen = index.mask2d(answer, posed)
    if kind == "mask":
        return pictures.png_bytes(seen.mask.astype(np.uint8) * 255)
    if kind == "relevancy":
        return pictures.png_bytes(pictures.relevancy_picture(seen.rgb, seen.relevancy))
    names = [(match.label_id, match.label) for match in answer.matches if match.relevant]
    return pictures.png_bytes(pictures.named_overlay(seen.rgb, seen.label_ids, names))


def _depth_png(depth: NDArray[np.float32], scale: float) -> bytes:
    """16-bit steps of `scale`; what is there is at least 1, and 65535 means so far or farther."""
    steps = np.clip(np.rint(depth.astype(np.float64) / scale), 1, _FARTHEST)
    return _png16(np.where(depth > 0, steps, 0).astype(np.uint16), {"depth_scale": repr(scale)})


def _depth_picture(depth: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Turbo over the range of depths that are there; near is red, nothing is black."""
    there = depth > 0
    if not there.any():
        return np.zeros((*depth.shape, 3), dtype=np.uint8)
    near, far = depth[there].min(), depth[there].max()
    coloured = pictures.turbo((far - depth) / max(far - near, 1e-9))
    coloured[~there] = 0
    return coloured


def _png16(values: NDArray[np.uint16], texts: dict[str, str] | None = None) -> bytes:
    info = PngImagePlugin.PngInfo()
    for name, text in (texts or {}).items():
        info.add_text(name, text)
    file = BytesIO()
    Image.fromarray(np.ascontiguousarray(values)).save(file, format="PNG", pnginfo=info)
    return file.getvalue()


def _npy(values: NDArray[Any]) -> bytes:
    file = BytesIO()
    np.save(file, values, allow_pickle=False)
    return file.getvalue()
