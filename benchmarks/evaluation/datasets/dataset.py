"""A data set with its truth and its split."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from benchmarks.evaluation.localization import Box
from benchmarks.evaluation.validation_split import Split
from fastsplat.service.common.dictionary import Dictionary
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.geometry.camera import PosedCamera

Kind = Literal["nerfstudio", "colmap", "lerf_ovs", "lerf_mask", "3d_ovs"]


@dataclass(frozen=True)
class QueryTruth:
    """Where the answer to one text is in one view.

    Attributes:
        text: as annotated.
        mask: bool [H, W], all instances together.
        boxes: one an instance, pixels of the view.
    """

    text: str
    mask: NDArray[np.bool_]
    boxes: tuple[Box, ...]


@dataclass(frozen=True)
class TrueView:
    """One view of the test split; arrays are of its camera's size, undistorted and upright as training views are.

    Attributes:
        name: of the image, as in captures.
        posed: its camera, or None when the data set annotates an image without giving it a pose: then every prediction
            for it is missing, and counts as zero.
        rgb: uint8 [H, W, 3], or None without a pose.
        valid: bool [H, W], pixels that have content and count; None when all do.
        labels: int32 [H, W] ids of the data set's dictionary, 0 where no label is; None without a label map.
        depth: float32 [H, W] camera z in scene units, 0 where unknown; None without a depth map.
        queries: annotated texts; a text that is not among them was not annotated in this view.
        instances: int32 [H, W] the object that each pixel shows, 1 the first, 0 where none is; None where the data set
            does not tell objects of one label apart.
    """

    name: str
    posed: PosedCamera | None
    rgb: NDArray[np.uint8] | None = None
    valid: NDArray[np.bool_] | None = None
    labels: NDArray[np.int32] | None = None
    depth: NDArray[np.float32] | None = None
    queries: tuple[QueryTruth, ...] = ()
    instances: NDArray[np.int32] | None = None


@dataclass(frozen=True)
class Dataset:
    """A data set with its split.

    Attributes:
        folder: where it lies; never written to.
        kind: its layout.
        dictionary: the labels of the label maps, or the annotated texts; may be empty.
        train: names of the views that a scene may be trained on.
        test: the views that it is measured on; none of them is in `train`.
        mask_label: the name of what binary masks show, or "".
        notes: what was left aside or made up for, as sentences for people.
        instances: the label of each object of the views' `instances`, from 1; empty without.
        split: what `test` holds: the test views, or validation views in their place.

    Raises:
        InvalidInputError: no test views, or a view in both splits.
    """

    folder: Path
    kind: Kind
    dictionary: Dictionary
    train: tuple[str, ...]
    test: tuple[TrueView, ...]
    mask_label: str = ""
    notes: tuple[str, ...] = ()
    instances: tuple[str, ...] = ()
    split: Split = "test"

    def __post_init__(self) -> None:
        if not self.test:
            raise InvalidInputError(
                f"{self.folder.name} has no test views", field="split", hint="Give it more images or a test split."
            )
        both = sorted({view.name for view in self.test} & set(self.train))
        if both:
            raise InvalidInputError(
                f"{both[0]} is in the training and in the test split of {self.folder.name}",
                field="split",
                hint="Name every image in one of them.",
            )
