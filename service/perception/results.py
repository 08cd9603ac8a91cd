"""Results of perception, and protocols of its models."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.common.dictionary import Dictionary
from fastsplat_contract.messages.object_reads import ReadKind

Image = NDArray[np.uint8]
"""uint8 [H, W, 3] RGB."""


@dataclass(frozen=True)
class Writing:
    """A text or code shown in a picture."""

    kind: ReadKind  # see `ObjectRead`
    text: str
    probability: float  # 0..1, of exactly this text, by the reader; codes check themselves
    corners: NDArray[np.float32]  # [4, 2] pixels, clockwise, from the top left if known


class LineReader(Protocol):
    """Reads lines of text."""

    def read(self, image: Image) -> list[Writing]:
        """Reads the lines of an image."""


@dataclass(frozen=True)
class Regions:
    """Region proposals of a view with votes for their classes, before the views agree."""

    ids: NDArray[np.uint16]  # [H, W], region 1..R of each pixel, 0 = none
    votes: tuple[tuple[tuple[int, float], ...], ...]  # per region, (label id, score 0..1): several for rivals, or none

    def __post_init__(self) -> None:
        assert self.ids.ndim == 2 and self.ids.dtype == np.uint16 and int(self.ids.max(initial=0)) <= len(self.votes)

    def masks(self) -> ViewMasks | None:
        """Converts each region to a mask; None without any."""
        if not self.votes:
            return None
        height, width = self.ids.shape
        bits = np.stack([np.packbits(self.ids == number) for number in range(1, len(self.votes) + 1)])
        return ViewMasks(bits, np.ones(len(bits), np.float32), width, height, prompts=0)

    def resized(self, width: int, height: int) -> NDArray[np.uint16]:
        """The ids at another size, nearest pixel."""
        rows = ((np.arange(height) + 0.5) * self.ids.shape[0] / height).astype(np.int64)
        columns = ((np.arange(width) + 0.5) * self.ids.shape[1] / width).astype(np.int64)
        return np.asarray(self.ids[rows][:, columns])


@dataclass(frozen=True)
class ViewMasks:
    """P masks without names of a view, which may overlap."""

    bits: NDArray[np.uint8]  # [P, ceil(height·width / 8)], `numpy.packbits` of each mask, row by row
    quality: NDArray[np.float32]  # [P], predicted intersection over union times stability, 0..1
    width: int  # of the masks: that of the view's image, possibly reduced
    height: int
    prompts: int  # number that the segmenter answered

    def __post_init__(self) -> None:
        assert self.bits.shape == (len(self.quality), -(-self.width * self.height // 8))
        assert self.bits.dtype == np.uint8 and self.quality.dtype == np.float32

    def __len__(self) -> int:
        return len(self.quality)

    def resized(self, width: int, height: int) -> NDArray[np.bool_]:
        """bool [P, height, width]: the masks at a size, nearest pixel."""
        count = self.width * self.height
        masks = np.unpackbits(self.bits, axis=1, count=count).reshape(len(self), self.height, self.width).astype(bool)
        if (width, height) == (self.width, self.height):
            return masks
        rows = ((np.arange(height) + 0.5) * self.height / height).astype(np.int64)
        columns = ((np.arange(width) + 0.5) * self.width / width).astype(np.int64)
        return np.asarray(masks[:, rows][:, :, columns])

    def within(self, content: NDArray[np.bool_]) -> ViewMasks:
        """Cuts masks to the pixels with content, bool [H, W] of the view's image.

        Masks with less than half inside are dropped, as they show what a photo withholds.
        """
        rows = ((np.arange(self.height) + 0.5) * content.shape[0] / self.height).astype(np.int64)
        columns = ((np.arange(self.width) + 0.5) * content.shape[1] / self.width).astype(np.int64)
        whole = self.resized(self.width, self.height)
        cut = whole & content[rows][:, columns]
        mostly = 2 * cut.sum((1, 2)) >= whole.sum((1, 2))
        bits = np.packbits(cut[mostly].reshape(-1, self.width * self.height), axis=1)
        return ViewMasks(bits, self.quality[mostly], self.width, self.height, self.prompts)


@dataclass(frozen=True)
class Labelling:
    """The scene's dictionary and a label map per view."""

    dictionary: Dictionary  # all labels, with pixel and view counts
    label_maps: tuple[NDArray[np.uint16], ...]  # [H, W] per view, 0 is undetected; all 0: not looked at, or nothing
    exact: bool = False  # maps of the capture, the truth; 0 is "none of these classes" in a map that names anything
    regions: tuple[Regions, ...] = ()  # per view, sources of the label maps; empty if nothing was detected by us
    masks: tuple[ViewMasks | None, ...] = ()  # per view, masks without names; None, or empty, if not looked for
    searched: tuple[str, ...] | None = None  # names that a detector looked for; None if unknown, or no detector
    looked_at: tuple[int, ...] | None = None  # numbers of the views that a detector looked at; None as `searched`
    detector: str = ""  # as the settings name it; "" if unknown, or none

    def __post_init__(self) -> None:
        assert len(self.regions) in (0, len(self.label_maps))
        assert not (self.masks and self.label_maps) or len(self.masks) == len(self.label_maps)
        for label_map in self.label_maps:
            assert label_map.ndim == 2 and label_map.dtype == np.uint16
            assert int(label_map.max(initial=0)) <= len(self.dictionary)

    def learnt(self) -> Labelling:
        """The labelling that Gaussians learn: this one, or without detected labels.

        Detections of single views contradict each other; they are counted once there are objects to name.
        """
        return Labelling(Dictionary(()), ()) if self.regions else self


@dataclass(frozen=True)
class Detections:
    """Boxes of an image, with scores and labels."""

    boxes: NDArray[np.float32]  # [K, 4]: x1, y1, x2, y2 in pixels (corners of the image are 0, 0 and W, H)
    scores: NDArray[np.float32]  # [K], 0..1
    labels: tuple[str, ...]

    def __post_init__(self) -> None:
        assert self.boxes.shape == (len(self.labels), 4) and self.boxes.dtype == np.float32
        assert self.scores.shape == (len(self.labels),) and self.scores.dtype == np.float32

    def take(self, rows: Sequence[int] | NDArray[np.intp]) -> Detections:
        """Selects rows, in this order."""
        index = np.asarray(rows, dtype=np.intp)
        return Detections(self.boxes[index], self.scores[index], tuple(self.labels[i] for i in index))

    def __len__(self) -> int:
        return len(self.labels)


def joined(parts: Sequence[Detections]) -> Detections:
    """Joins several looks at one image, best detections first."""
    if not parts:
        return Detections(np.zeros((0, 4), np.float32), np.zeros(0, np.float32), ())
    together = Detections(
        np.concatenate([part.boxes for part in parts]),
        np.concatenate([part.scores for part in parts]),
        tuple(label for part in parts for label in part.labels),
    )
    return together.take(np.argsort(-together.scores, kind="stable"))


class ClosedSetDetector(Protocol):
    """Detects objects of a fixed list of classes."""

    @property
    def labels(self) -> tuple[str, ...]:
        """All classes that it knows."""

    def detect(self, image: Image, min_score: float) -> Detections:
        """Detects objects that score at least `min_score`."""


class OpenSetDetector(Protocol):
    """Detects objects by name."""

    def detect(self, image: Image, prompts: Sequence[str], min_score: float) -> Detections:
        """Detects objects that score at least `min_score`, with labels among `prompts`."""


@dataclass(frozen=True)
class Prompts:
    """K prompts for a segmenter, of N points each."""

    points: NDArray[np.float32]  # [K, N, 2], x and y in pixels of the image
    kinds: NDArray[np.float32]  # [K, N], 1 inside, 0 outside, 2 and 3 a box's corners, -1 a filler (Segment-Anything)

    def __post_init__(self) -> None:
        assert self.points.ndim == 3 and self.points.shape[2] == 2 and self.points.dtype == np.float32
        assert self.kinds.shape == self.points.shape[:2] and self.kinds.dtype == np.float32

    def __len__(self) -> int:
        return len(self.points)


def point_prompts(points: NDArray[np.floating[Any]]) -> Prompts:
    """Builds a prompt for each of [K, 2] points."""
    padded = np.stack([points, np.zeros_like(points)], axis=1).astype(np.float32)
    return Prompts(padded, np.tile(np.array([[1, -1]], np.float32), (len(points), 1)))


def box_prompts(boxes: NDArray[np.floating[Any]]) -> Prompts:
    """Builds a prompt for each of [K, 4] boxes x1, y1, x2, y2."""
    corners = np.asarray(boxes, np.float32).reshape(-1, 2, 2)
    return Prompts(corners, np.tile(np.array([[2, 3]], np.float32), (len(boxes), 1)))


@dataclass(frozen=True)
class MaskLogits:
    """A segmenter's answers to K prompts, M each (part, object, group)."""

    logits: NDArray[np.float32]  # [K, M, h, w], positive inside, on the segmenter's grid, which covers just the image
    quality: NDArray[np.float32]  # [K, M], predicted intersection over union, 0..1
    scale: tuple[float, float]  # grid steps per pixel of the image, along x and y

    def __post_init__(self) -> None:
        assert self.logits.ndim == 4 and self.quality.shape == self.logits.shape[:2]


class Segmenter(Protocol):
    """Segments prompted objects; the slow `embed` runs once an image."""

    def embed(self, image: Image) -> Any:
        """Computes the embedding of an image, for the other methods."""

    def masks(self, embedding: Any, boxes: NDArray[np.float32]) -> NDArray[np.bool_]:
        """bool [K, H, W] for float32 [K, 4] boxes (x1, y1, x2, y2 in pixels)."""

    def mask_logits(self, embedding: Any, prompts: Prompts) -> MaskLogits:
        """Returns all answers to all prompts."""


class TextEncoder(Protocol):
    """Embeddings of texts."""

    @property
    def name(self) -> str:
        """The model's name in the settings."""

    @property
    def sha256(self) -> str:
        """Hex digest of the weights; embeddings of different ones must not be compared."""

    def encode(self, texts: Sequence[str]) -> NDArray[np.float32]:
        """float32 [B, E] of unit length; a text's row does not depend on the others."""
