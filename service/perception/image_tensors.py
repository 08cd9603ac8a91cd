"""Images as input tensors of models."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image as PillowImage
from PIL.Image import Resampling
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, PositiveFloat

from fastsplat.service.perception.results import Image
from fastsplat_contract.errors import ModelUnavailableError

_AROUND = 1.2  # side of the cut-out square over the longer side of the object's box
_GRAY = (123.675, 116.28, 103.53)


def imagenet_tensor(image: Image, side: int, *, cubic: bool = False) -> NDArray[np.float32]:
    """float32 [1, 3, side, side]: resized without keeping the aspect, ImageNet-normalized."""
    resized = cv2.resize(image, (side, side), interpolation=cv2.INTER_CUBIC if cubic else cv2.INTER_LINEAR)
    return IMAGENET.normalized(resized.astype(np.float32) / np.float32(255))


def _only(size: Any) -> Any:
    sizes = size.values() if isinstance(size, dict) else size if isinstance(size, list) else [size]
    return min(sizes) if min(sizes) == max(sizes) else size


def _resampling(how: Any) -> Any:
    return Resampling[how.upper()] if isinstance(how, str) else how


class Preprocessing(BaseModel):
    """How a network wants its square images, in the words of open_clip and Hugging Face."""

    model_config = ConfigDict(frozen=True, populate_by_name=True)

    size: Annotated[int, BeforeValidator(_only), Field(ge=1)]
    mean: tuple[float, float, float] = Field(alias="image_mean")
    std: tuple[PositiveFloat, PositiveFloat, PositiveFloat] = Field(alias="image_std")
    interpolation: Annotated[Resampling, BeforeValidator(_resampling)] = Field(alias="resample")
    do_normalize: Literal[True] = True

    def tensor(self, image: Image) -> NDArray[np.float32]:
        """float32 [1, 3, size, size]: resized with antialiasing, without keeping the aspect, and normalized."""
        pixels = np.asarray(PillowImage.fromarray(image).resize((self.size, self.size), self.interpolation), np.float32)
        return self.normalized(pixels / np.float32(255))

    def normalized(self, pixels: NDArray[np.float32]) -> NDArray[np.float32]:
        """float32 [1, 3, H, W] of pixels [H, W, 3] in 0..1."""
        mean, std = np.array([self.mean, self.std], np.float32)
        return _planar((pixels - mean) / std)


IMAGENET = Preprocessing(
    size=384, mean=(0.485, 0.456, 0.406), std=(0.229, 0.224, 0.225), interpolation=Resampling.BILINEAR
)
_MEAN, _STD = (0.48145466, 0.4578275, 0.40821073), (0.26862954, 0.26130258, 0.27577711)
CLIP = Preprocessing(size=224, mean=_MEAN, std=_STD, interpolation=Resampling.BICUBIC)


def read_preprocessing(path: Path, *, name: str) -> Preprocessing:
    """Reads `preprocess_cfg.json` or `preprocessor_config.json`; may raise `ModelUnavailableError`."""
    try:
        return Preprocessing.model_validate(json.loads(path.read_bytes()))
    except (OSError, ValueError, TypeError, KeyError) as error:
        hint = "It needs a size of squares, three means, three deviations above 0, and a resampling of Pillow."
        raise ModelUnavailableError(f"model {name}: {path.name}: {error}", field=name, hint=hint) from error


def square_around(image: Image, mask: NDArray[np.bool_], side: int | None = None) -> tuple[Image, NDArray[np.bool_]]:
    """Cuts out a square around a non-empty mask, and the mask in it.

    Returns uint8 [side, side, 3], gray outside of the image, and bool [side, side]; None: unscaled pixels.
    """
    left, top, width, height = cv2.boundingRect(mask.astype(np.uint8))
    around = _AROUND * max(width, height)
    side, scale = (side, side / around) if side else (round(around), 1.0)
    matrix = np.array(
        [[scale, 0, side / 2 - (left + width / 2) * scale], [0, scale, side / 2 - (top + height / 2) * scale]]
    )
    how = cv2.INTER_LINEAR if scale > 1 else cv2.INTER_AREA
    crop = cv2.warpAffine(image, matrix, (side, side), flags=how, borderValue=_GRAY)
    inside = cv2.warpAffine(mask.astype(np.float32), matrix, (side, side)) > 0.5
    return np.asarray(crop, np.uint8), np.asarray(inside)


@dataclass(frozen=True)
class Letterbox:
    """An image in a square; (x, y) maps to (x·scale + left, y·scale + top)."""

    scale: float
    left: int
    top: int

    def to_image(self, boxes: NDArray[np.float32]) -> NDArray[np.float32]:
        """Converts boxes [K, 4] from the square to the image."""
        shift = np.array([self.left, self.top, self.left, self.top], np.float32)
        return ((boxes - shift) / self.scale).astype(np.float32)


def letterboxed(image: Image, side: int) -> tuple[NDArray[np.float32], Letterbox]:
    """float32 [1, 3, side, side] in 0..1 with the image centered, and its place."""
    height, width = image.shape[:2]
    scale = side / max(height, width)
    inner_w, inner_h = max(1, round(width * scale)), max(1, round(height * scale))
    left, top = (side - inner_w) // 2, (side - inner_h) // 2
    canvas = np.full((side, side, 3), 114, np.uint8)
    canvas[top : top + inner_h, left : left + inner_w] = cv2.resize(image, (inner_w, inner_h))
    return _planar(canvas.astype(np.float32) / 255), Letterbox(scale, left, top)


def long_side_padded(image: Image, side: int, fill: NDArray[np.float32]) -> tuple[NDArray[np.float32], float]:
    """float32 [1, 3, side, side], 0..255, padded at right and bottom; and the scale."""
    height, width = image.shape[:2]
    scale = side / max(height, width)
    inner_w, inner_h = max(1, int(width * scale + 0.5)), max(1, int(height * scale + 0.5))
    canvas = np.empty((side, side, 3), np.float32)
    canvas[:] = fill
    canvas[:inner_h, :inner_w] = cv2.resize(image, (inner_w, inner_h))
    return _planar(canvas), scale


def _planar(pixels: NDArray[np.floating[Any]]) -> NDArray[np.float32]:
    return np.ascontiguousarray(pixels.transpose(2, 0, 1)[None], dtype=np.float32)
