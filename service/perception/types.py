"""The results of perception, and the protocols of its models."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.common.dictionary import Dictionary
from fastsplat_contract.thing_reads import ReadKind

Image = NDArray[np.uint8]
"""uint8 [H, W, 3] RGB."""


@dataclass(frozen=True)
class Writing:
    """Something that a picture shows written.

    Attributes:
        kind: see `ThingRead`.
        probability: 0..1, that it says exactly that, as the reader believes; codes check themselves.
        corners: float32 [4, 2] pixels, clockwise from the text's or code's top left where that is known.
    """

    kind: ReadKind
    text: str
    probability: float
    corners: NDArray[np.float32]


class LineReader(Protocol):
    """Reads lines of text."""

    def read(self, image: Image) -> list[Writing]:
        """The lines of uint8 [H, W, 3]."""


@dataclass(frozen=True)
class Regions:
    """Region proposals of one view and the votes for their classes, before the views agree.

    Attributes:
        ids: uint16 [H, W], region 1..R of each pixel, 0 = none.
        votes: for each region, label ids and the scores that the detector gave them, 0..1; several where rivals had the
            same place, none for a region that nobody classified.
    """

    ids: NDArray[np.uint16]
    votes: tuple[tuple[tuple[int, float], ...], ...]

    def __post_init__(self) -> None:
        assert self.ids.ndim == 2 and self.ids.dtype == np.uint16 and int(self.ids.max(initial=0)) <= len(self.votes)

    def masks(self) -> ViewMasks | None:
        """Each region as a mask; None without any."""
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
    """P masks without names of one view, which may overlap: what is there, whatever it is.

    Attributes:
        bits: uint8 [P, ceil(height·width / 8)], `numpy.packbits` of each mask, row by row.
        quality: float32 [P], predicted intersection over union times stability, 0..1.
        width, height: of the masks; the view's image, possibly reduced.
        prompts: how many the segmenter answered.
    """

    bits: NDArray[np.uint8]
    quality: NDArray[np.float32]
    width: int
    height: int
    prompts: int

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
        """The masks cut to the pixels that have content, bool [H, W] of the view's image; without those of which more
        than half is elsewhere: they are of what a photo withholds."""
        rows = ((np.arange(self.height) + 0.5) * content.shape[0] / self.height).astype(np.int64)
        columns = ((np.arange(self.width) + 0.5) * content.shape[1] / self.width).astype(np.int64)
        whole = self.resized(self.width, self.height)
        cut = whole & content[rows][:, columns]
        mostly = 2 * cut.sum((1, 2)) >= whole.sum((1, 2))
        bits = np.packbits(cut[mostly].reshape(-1, self.width * self.height), axis=1)
        return ViewMasks(bits, self.quality[mostly], self.width, self.height, self.prompts)


@dataclass(frozen=True)
class Labelling:
    """The scene's dictionary and one label map per view.

    Attributes:
        dictionary: all labels of all views, with pixel and view counts.
        label_maps: one uint16 [H, W] per view of the capture, in its order, of its image size; 0 is undetected. A
            map of zeros alone says nothing: nobody looked, or nothing was detected.
        exact: the maps came with the capture and are the truth: they agree with each other, and 0 in a map that names
            anything is "none of these classes" rather than "not detected".
        regions: one per view, what the label maps were painted from; empty where nothing was detected by us.
        masks: one per view, its masks without names, None where nobody looked for any; empty where nobody did at all.
        searched: the names that a detector looked for; None where that is not known, or none did.
    """

    dictionary: Dictionary
    label_maps: tuple[NDArray[np.uint16], ...]
    exact: bool = False
    regions: tuple[Regions, ...] = ()
    masks: tuple[ViewMasks | None, ...] = ()
    searched: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        assert len(self.regions) in (0, len(self.label_maps))
        assert not (self.masks and self.label_maps) or len(self.masks) == len(self.label_maps)
        for label_map in self.label_maps:
            assert label_map.ndim == 2 and label_map.dtype == np.uint16
            assert int(label_map.max(initial=0)) <= len(self.dictionary)

    def learnt(self) -> Labelling:
        """What Gaussians learn: this labelling, or none of its labels where they were detected. Detections of single
        views contradict each other; they are counted once there are things for them to name."""
        return Labelling(Dictionary(()), ()) if self.regions else self


@dataclass(frozen=True)
class Detections:
    """Boxes of one image.

    Attributes:
        boxes: float32 [K, 4]: x1, y1, x2, y2 in pixels of the image (corners of the image are 0, 0 and W, H).
        scores: float32 [K], 0..1.
        labels: K names.
    """

    boxes: NDArray[np.float32]
    scores: NDArray[np.float32]
    labels: tuple[str, ...]

    def __post_init__(self) -> None:
        assert self.boxes.shape == (len(self.labels), 4) and self.boxes.dtype == np.float32
        assert self.scores.shape == (len(self.labels),) and self.scores.dtype == np.float32

    def take(self, rows: Sequence[int] | NDArray[np.intp]) -> Detections:
        """The detections of these rows, in this order."""
        index = np.asarray(rows, dtype=np.intp)
        return Detections(self.boxes[index], self.scores[index], tuple(self.labels[i] for i in index))

    def __len__(self) -> int:
        return len(self.labels)


def joined(parts: Sequence[Detections]) -> Detections:
    """All detections of several looks at one image, best first."""
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
        """All classes it can know."""

    def detect(self, image: Image, min_score: float) -> Detections:
        """Objects in uint8 [H, W, 3] that score at least `min_score`."""


class OpenSetDetector(Protocol):
    """Detects whatever is named."""

    def detect(self, image: Image, prompts: Sequence[str], min_score: float) -> Detections:
        """Objects in uint8 [H, W, 3] that score at least `min_score`; their labels are among `prompts`."""


@dataclass(frozen=True)
class Prompts:
    """K prompts for a segmenter, of N points each.

    Attributes:
        points: float32 [K, N, 2], x and y in pixels of the image.
        kinds: float32 [K, N], as in Segment-Anything: 1 inside, 0 outside, 2 and 3 a box's upper left and lower right
            corner, -1 a filler that means nothing.
    """

    points: NDArray[np.float32]
    kinds: NDArray[np.float32]

    def __post_init__(self) -> None:
        assert self.points.ndim == 3 and self.points.shape[2] == 2 and self.points.dtype == np.float32
        assert self.kinds.shape == self.points.shape[:2] and self.kinds.dtype == np.float32

    def __len__(self) -> int:
        return len(self.points)


def point_prompts(points: NDArray[np.floating[Any]]) -> Prompts:
    """One prompt for each of [K, 2] points: what is there."""
    padded = np.stack([points, np.zeros_like(points)], axis=1).astype(np.float32)
    return Prompts(padded, np.tile(np.array([[1, -1]], np.float32), (len(points), 1)))


def box_prompts(boxes: NDArray[np.floating[Any]]) -> Prompts:
    """One prompt for each of [K, 4] boxes x1, y1, x2, y2."""
    corners = np.asarray(boxes, np.float32).reshape(-1, 2, 2)
    return Prompts(corners, np.tile(np.array([[2, 3]], np.float32), (len(boxes), 1)))


@dataclass(frozen=True)
class MaskLogits:
    """A segmenter's answers to K prompts, M to each (a part, a thing, a group), on the segmenter's own grid.

    Attributes:
        logits: float32 [K, M, h, w], positive inside; the grid covers the image and no more.
        quality: float32 [K, M], predicted intersection over union, 0..1.
        scale: steps of the grid a pixel of the image, along x and y.
    """

    logits: NDArray[np.float32]
    quality: NDArray[np.float32]
    scale: tuple[float, float]

    def __post_init__(self) -> None:
        assert self.logits.ndim == 4 and self.quality.shape == self.logits.shape[:2]


class Segmenter(Protocol):
    """Masks of what boxes show. `embed` is the slow half and runs once an image."""

    def embed(self, image: Image) -> Any:
        """What `masks` needs to know of uint8 [H, W, 3]."""

    def masks(self, embedding: Any, boxes: NDArray[np.float32]) -> NDArray[np.bool_]:
        """bool [K, H, W] for float32 [K, 4] boxes (x1, y1, x2, y2 in pixels of the image)."""

    def mask_logits(self, embedding: Any, prompts: Prompts) -> MaskLogits:
        """Every answer to every prompt, none chosen."""


class TextEncoder(Protocol):
    """Embeddings of texts."""

    @property
    def name(self) -> str:
        """The model's name in the settings."""

    @property
    def sha256(self) -> str:
        """Of the weights, in hex: embeddings of different hashes must not be compared."""

    def encode(self, texts: Sequence[str]) -> NDArray[np.float32]:
        """float32 [B, E] of unit length; a text's row does not depend on the others."""
