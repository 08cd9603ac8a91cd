"""Selection among a segmenter's answers to prompts of people, and to rendered pieces."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from fastsplat.service.perception.results import MaskLogits, Prompts, Segmenter
from fastsplat.service.perception.segmenters.mask_postprocessing import box_agreement, stability, upsampled

Mask = NDArray[np.bool_]
F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

_LEAST_PX = 12  # smaller masks are ignored
_WHOLE = 0.9  # an answer with this share of the object to be split is hardly a piece of it
_EATEN = 0.8  # an object with this share inside an answer counts as part of it
_DOUBT = 0.5  # factor for such an answer, and for one that contradicts the prompt's pixels
_NEARLY, _LARGER = 0.75, 5.0  # the largest answer with this share of the best score, at most so many times larger, wins
_AGREES = 0.6  # least overlap times stability of an answer that matches a rendered piece
_AROUND = 0.5  # background prompts lie within this share of the box's size around it


@dataclass(frozen=True)
class PicturePrompt:
    """A prompt in pixels of the picture."""

    pixels: F64  # [N, 2], x and y on the object
    background: F64  # [M, 2], beside it
    box: F64 | None = None  # [4], x1, y1, x2, y2 around it

    def scaled(self, x: float, y: float) -> PicturePrompt:
        """Scales the prompt to a picture `x` times as wide and `y` times as high."""
        factors = np.array([x, y])
        box = None if self.box is None else self.box * np.tile(factors, 2)
        return PicturePrompt(self.pixels * factors, self.background * factors, box)

    def prompts(self) -> Prompts:
        """Converts to the segmenter's input; without a box, Segment-Anything needs a filler point."""
        end = np.zeros((1, 2)) if self.box is None else self.box.reshape(2, 2)
        points = np.concatenate([self.pixels, self.background, end])
        kinds = [1.0] * len(self.pixels) + [0.0] * len(self.background) + ([-1.0] if self.box is None else [2.0, 3.0])
        return Prompts(points[None].astype(np.float32), np.array([kinds], np.float32))


def values_at(image: NDArray[Any], pixels: F64) -> NDArray[Any]:
    """Samples an image [H, W] at pixels [N, 2], clamped to the far edges."""
    height, width = image.shape
    x, y = pixels.astype(np.int64).T
    return np.asarray(image[np.minimum(y, height - 1), np.minimum(x, width - 1)])


def prompted_mask(
    answer: MaskLogits, prompt: PicturePrompt, ids: NDArray[np.integer], inside: Mask | None
) -> Mask | None:
    """Chooses the intended answer to a prompt, bool [H, W]; None if all are specks.

    Segment-Anything answers with a part, an object and a group. Each scores by its predicted intersection over union
    times its stability, its agreement with the prompt's pixels and box, and its relation to known objects: for a piece
    the share inside the object to be split, for a missing object the share that is not made of other whole objects.

    Args:
        answer: to one prompt.
        ids: int [H, W], the object of each pixel, 0 for none.
        inside: bool [H, W], the object to be split; None for a missing object.
    """
    masks = _enlarged(answer, ids.shape[1], ids.shape[0])
    areas = masks.sum(axis=(1, 2))
    stable = np.array([stability(layer) for layer in answer.logits[0]])
    scores = np.where(areas >= _LEAST_PX, answer.quality[0] * stable, 0.0)
    for number in np.flatnonzero(scores):
        scores[number] *= _fit(masks[number], prompt)
        if inside is None:
            scores[number] *= 1 - _eaten(masks[number], prompt, ids) / areas[number]
        else:
            common = int((masks[number] & inside).sum())
            scores[number] *= common / areas[number] * (_DOUBT if common > _WHOLE * inside.sum() else 1)
    best = int(scores.argmax())
    if scores[best] <= 0:
        return None
    nearly = (scores >= _NEARLY * scores[best]) & (areas <= _LARGER * areas[best])
    return np.asarray(masks[np.where(nearly, areas, -1).argmax()])


def matching_mask(segmenter: Segmenter, embedding: Callable[[], Any], drawn: F32) -> Mask | None:
    """Segments a rendered piece in a view, bool [H, W]; None if unclear.

    Prompts are the piece's box, its innermost pixel, both, and that pixel with one beside the piece. Answers score by
    overlap with the piece times stability.

    Args:
        drawn: float32 [H, W, 3], shares of each pixel: piece, known other, unknown.
    """
    piece, outside = drawn[..., 0], drawn[..., 1]
    piece_mask = piece > np.maximum(0.5 * drawn.sum(axis=2), 0.25)
    if piece_mask.sum() < _LEAST_PX:
        return None
    height, width = piece_mask.shape
    known, total = embedding(), float(piece.sum())
    best, highest = None, 0.0
    for prompt in _prompts_for(piece_mask, outside > 0.5):
        answer = segmenter.mask_logits(known, prompt.prompts())
        for layer, mask in zip(answer.logits[0], _enlarged(answer, width, height), strict=True):
            score = float(piece[mask].sum()) / (total + float(outside[mask].sum())) * stability(layer)
            if score > highest:
                best, highest = mask, score
    return best if highest >= _AGREES else None


def _prompts_for(piece_mask: Mask, outside: Mask) -> list[PicturePrompt]:
    columns, rows = np.flatnonzero(piece_mask.any(0)), np.flatnonzero(piece_mask.any(1))
    box = np.array([columns[0], rows[0], columns[-1] + 1, rows[-1] + 1], np.float64)
    margin = _AROUND * (box[2:] - box[:2])
    left, top = np.maximum(box[:2] - margin, 0).astype(int)
    right, bottom = np.ceil(box[2:] + margin).astype(int)
    near = np.zeros_like(outside)
    near[top:bottom, left:right] = outside[top:bottom, left:right]
    middle, nothing = _deepest(piece_mask), np.zeros((0, 2))
    prompts = [PicturePrompt(middle, nothing, box), PicturePrompt(nothing, nothing, box)]
    beside = [_deepest(near)] if near.any() else []
    return prompts + [PicturePrompt(middle, background) for background in (nothing, *beside)]


def _enlarged(answer: MaskLogits, width: int, height: int) -> NDArray[np.bool_]:
    return upsampled(answer.logits[0], answer.scale, (height, width), width, height)


def _fit(mask: Mask, prompt: PicturePrompt) -> float:
    """Agreement of a mask with the prompt's pixels and box, 0..1."""
    on, beside = values_at(mask, prompt.pixels), values_at(mask, prompt.background)
    score = (1.0 if on.all() else _DOUBT) * (_DOUBT if beside.any() else 1.0)
    return score if prompt.box is None else score * box_agreement(mask, prompt.box)


def _eaten(mask: Mask, prompt: PicturePrompt, ids: NDArray[np.integer]) -> int:
    """Counts a mask's pixels of objects that are almost wholly inside and were not prompted."""
    whole = np.bincount(ids.ravel())
    within = np.bincount(ids[mask], minlength=len(whole))
    eaten = within > _EATEN * whole
    eaten[0] = False
    eaten[values_at(ids, prompt.pixels)] = False
    return int(within[eaten].sum())


def _deepest(mask: Mask) -> F64:
    """Returns x and y, [1, 2], of the pixel farthest from mask and image edges."""
    depth = cv2.distanceTransform(np.pad(mask.astype(np.uint8), 1), cv2.DIST_L2, 3)[1:-1, 1:-1]
    row, column = np.unravel_index(int(depth.argmax()), depth.shape)
    return np.array([[column + 0.5, row + 0.5]])
