"""Images of answers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from io import BytesIO

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.photos.pictures import Tint

U8 = NDArray[np.uint8]

_RANKED = ((255, 96, 16), (48, 144, 255), (96, 200, 80), (190, 110, 255), (255, 200, 40))
"""Tints of an answer's labels, best first; the last serves all further ones."""
_WIDEST_TAG = 1 / 3
_JPEG_QUALITY = 80
_GOLDEN = 0.618034
"""Hue step between consecutive ids, in turns, so that they look different."""
_OUTLINE = np.array([255, 255, 255], dtype=np.uint8)


def turbo(values: NDArray[np.floating]) -> U8:
    """Maps values [...] in 0..1 (clamped, NaN as 0) to Turbo, uint8 [..., 3]."""
    x = np.clip(np.nan_to_num(np.asarray(values, dtype=np.float64), nan=0.0), 0.0, 1.0)
    bgr = cv2.applyColorMap((x * 255).round().astype(np.uint8).reshape(-1, 1), cv2.COLORMAP_TURBO)
    return np.asarray(bgr[..., ::-1].reshape(*x.shape, 3), np.uint8)


def overlay(
    rgb: U8, mask: NDArray[np.bool_], *, colour: tuple[int, int, int] = (255, 64, 32), strength: float = 0.5
) -> U8:
    """Tints a mask on an image and outlines it in white, uint8 [H, W, 3].

    A mask of another size raises InvalidInputError."""
    if rgb.shape != (*mask.shape, 3):
        raise InvalidInputError(f"a mask of shape {mask.shape} on an image of shape {rgb.shape}", field="mask")
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    eroded = cv2.erode(mask.astype(np.uint8), cross, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    picture = rgb.copy()
    tinted = rgb[mask] * (1.0 - strength) + np.array(colour) * strength
    picture[mask] = tinted.round().astype(np.uint8)
    picture[mask & ~eroded.astype(np.bool_)] = _OUTLINE
    return picture


def named_overlay(
    rgb: U8, mask: NDArray[np.bool_], label_ids: NDArray[np.uint16], names: Sequence[tuple[int, str]]
) -> U8:
    """Tints a mask by labels (id and name, best first) and writes short names, uint8 [H, W, 3]."""
    unnamed = mask & ~np.isin(label_ids, [label_id for label_id, _ in names])
    picture, tags = overlay(rgb, unnamed, colour=_RANKED[0], strength=0.6), []
    for rank, (label_id, name) in enumerate(names):
        mask = label_ids == label_id
        if mask.any():
            strength = 0.6 if rank == 0 else 0.4
            picture = overlay(picture, mask, colour=_RANKED[min(rank, len(_RANKED) - 1)], strength=strength)
            tags.append((_middle_of_largest(mask), name))
    return _tagged(picture, tags)


def label_colors(labels: int) -> U8:
    """Color table for N labels, uint8 [N + 1, 3]: black for undetected, neighbors differ."""
    hue = (np.arange(labels, dtype=np.float64) * _GOLDEN) % 1.0
    light = np.where(np.arange(labels) % 2, 0.55, 0.95)[:, None]
    channels = [np.clip(np.abs(((hue + offset) % 1.0) * 6 - 3) - 1, 0, 1) for offset in (0, 1 / 3, 2 / 3)]
    rgb = np.stack(channels, axis=1) * light * 255
    return np.asarray(np.concatenate([np.zeros((1, 3)), rgb]).round(), dtype=np.uint8)


def objects_picture(rgb: U8, object_ids: NDArray[np.uint16], names: Mapping[int, str]) -> U8:
    """Colors objects by id, with names, over the gray view, uint8 [H, W, 3]."""
    grey = rgb @ np.array([0.299, 0.587, 0.114])
    colors = label_colors(int(object_ids.max(initial=0)))[object_ids]
    tinted = np.where((object_ids > 0)[..., None], 0.4 * grey[..., None] + 0.6 * colors, grey[..., None])
    present = [object_id for object_id in np.unique(object_ids).tolist() if names.get(object_id)]
    tags = [(_middle_of_largest(object_ids == object_id), names[object_id]) for object_id in present]
    return _tagged(tinted.round().astype(np.uint8), tags)


def tinted_picture(rgb: U8, object_ids: NDArray[np.uint16], tints: Sequence[Tint], dimming: float) -> U8:
    """Tints objects (last tint wins) and dims the rest by `dimming`, uint8 [H, W, 3]."""
    size = 1 + max([int(object_ids.max(initial=0)), *(number for tint in tints for number in tint.object_ids)])
    weights, added = np.full((size, 1), 1.0 - dimming, np.float32), np.zeros((size, 3), np.float32)
    for tint in tints:
        rows = list(tint.object_ids)
        weights[rows] = 1.0 - tint.strength
        added[rows] = 255.0 * tint.strength * np.array(tint.color, np.float32)
    mixed = rgb * weights[object_ids]
    mixed += added[object_ids]
    return np.asarray(mixed.round().astype(np.uint8))


def _tagged(picture: U8, tags: Sequence[tuple[tuple[float, float], str]]) -> U8:
    """Draws texts at (x, y) in pixels."""
    image = Image.fromarray(picture)
    draw = ImageDraw.Draw(image)
    font = ImageFont.load_default(max(10, picture.shape[0] // 28))
    for place, name in tags:
        box = draw.textbbox(place, name, font=font, anchor="mm")
        if box[2] - box[0] > _WIDEST_TAG * picture.shape[1]:
            continue  # on a thumbnail the name would hide what it names
        draw.rectangle(box, fill=(0, 0, 0))
        draw.text(place, name, font=font, anchor="mm", fill=(255, 255, 255))
    return np.array(image)


def _middle_of_largest(mask: NDArray[np.bool_]) -> tuple[float, float]:
    """Centroid (x, y) of the largest connected component, pixels."""
    _, _, stats, centroids = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
    largest = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    return float(centroids[largest, 0]), float(centroids[largest, 1])


def relevancy_picture(rgb: U8, relevancy: NDArray[np.float32]) -> U8:
    """Overlays relevancy [H, W] in Turbo, unstretched, on the gray image, uint8 [H, W, 3]."""
    grey = rgb @ np.array([0.299, 0.587, 0.114])
    mixed = 0.7 * turbo(relevancy) + 0.3 * grey[..., None]
    return np.asarray(mixed.round().clip(0, 255), dtype=np.uint8)


def jpeg_bytes(image: U8) -> bytes:
    """Encodes uint8 [H, W, 3], RGB, as JPEG."""
    file = BytesIO()
    Image.fromarray(np.ascontiguousarray(image)).save(file, format="JPEG", quality=_JPEG_QUALITY)
    return file.getvalue()


def png_bytes(image: U8) -> bytes:
    """Encodes uint8 [H, W, 3] (RGB) or [H, W] (gray) as PNG, else raises InvalidInputError."""
    if image.dtype != np.uint8 or image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] != 3):
        raise InvalidInputError(f"an image of shape {image.shape} and type {image.dtype}", field="image")
    file = BytesIO()
    Image.fromarray(np.ascontiguousarray(image)).save(file, format="PNG")
    return file.getvalue()
