"""Lists of names and views that published evaluations use, and the figures over points that go with ScanNet's."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.evaluation.segmentation import MaskCounts, mask_counts
from fastsplat_contract.errors import InvalidInputError

UNLABELED = 0
_OPACITY_MIN = 0.1


@dataclass(frozen=True)
class AnnotatedViews:
    """What LEGaussians (Shi et al. 2024) asks of a scene of Mip-NeRF 360, and in which views.

    Attributes:
        texts: as asked, spelling included.
        views: names of images without extension.
    """

    texts: tuple[str, ...]
    views: tuple[str, ...]


def _numbered(prefix: str, numbers: str) -> tuple[str, ...]:
    return tuple(f"{prefix}{number}" for number in numbers.split())


MIPNERF360: Mapping[str, AnnotatedViews] = MappingProxyType(
    {
        "bicycle": AnnotatedViews(
            ("green grass", "white bicycle", "tire", "bench", "Asphalt ground", "Silver Oak Tree"),
            _numbered(
                "_DSC",
                "8683 8695 8705 8709 8713 8715 8721 8733 8738 8746 8751 8756 8776 8812 8824 8830 8836 8848 8872",
            ),
        ),
        "bonsai": AnnotatedViews(
            (
                "piano keyboard", "bicycle", "purple table cloth", "black stool", "plastic bonsai tree",
                "dark grey patterned carpet",
            ),
            _numbered(
                "DSCF",
                "5565 5575 5585 5595 5605 5615 5625 5635 5645 5655 5660 5675 5685 5695 5710 5720 5730 5740 5745 5755 "
                "5765 5775 5785 5790 5800 5810 5824 5838 5850",
            ),
        ),
        "counter": AnnotatedViews(
            (
                "Jar of coconut oil", "fruit oranges", "onions", "plants", "blue Oven Gloves", "Wood Rolling Pin",
                "free range eggs box", "gold Ripple Baking Pan", "Napolina Tomatoes", "Garofalo pasta", "stale bread",
            ),
            _numbered(
                "DSCF",
                "5857 5865 5875 5885 5895 5905 5915 5925 5935 5945 5955 5965 5975 5985 5995 6005 6015 6025 6035 6045 "
                "6055 6065 6075 6085",
            ),
        ),
        "garden": AnnotatedViews(
            (
                "football", "wood round table", "green grass", "wood pot", "elderflower", "green plant",
                "bricks wall", "windows", "Hexagonal Stone ground",
            ),
            _numbered(
                "DSC0",
                "7956 7960 7970 7980 7990 8000 8010 8020 8030 8040 8050 8060 8070 8080 8090 8095 8120 8135",
            ),
        ),
        "kitchen": AnnotatedViews(
            (
                "LEGO Technic 856 Bulldozer", "Basket Weave Cloth", "Wood plat", "old pink striped cloth",
                "Red Oven Gloves",
            ),
            _numbered(
                "DSCF0",
                "660 670 680 690 700 710 720 730 740 750 760 775 785 795 805 815 822 825 835 845 855 865 880 890 900 "
                "910 920 930",
            ),
        ),
        "room": AnnotatedViews(
            (
                "blue grey chair", "silver gray curtain", "brown shoes", "yellow books", "deep dark green carpets",
                "green Yucca plant", "wine glasses and bottles", "yellow wood floors", "piano keyboard",
                "white wood door", "windows",
            ),
            _numbered(
                "DSCF",
                "4670 4680 4690 4700 4721 4730 4759 4770 4780 4795 4800 4816 4854 4867 4880 4908 4920 4925 4958",
            ),
        ),
    }
)  # fmt: skip
"""By scene: `configs/mipnerf360-rendering/` of github.com/buaavrcg/LEGaussians at commit ddf9793. Stump, flowers and
treehill have no annotations. FAST-Splat's table of Mip-NeRF 360 has kitchen and bicycle, without saying whose masks."""

SCANNET_NAMES: Mapping[int, str] = MappingProxyType(
    {
        1: "wall", 2: "floor", 3: "cabinet", 4: "bed", 5: "chair", 6: "sofa", 7: "table", 8: "door", 9: "window",
        10: "bookshelf", 11: "picture", 12: "counter", 14: "desk", 16: "curtain", 24: "refrigerator",
        28: "shower curtain", 33: "toilet", 34: "sink", 36: "bathtub",
    }
)  # fmt: skip
"""Ids of NYU40 and names of ScanNet's classes but for "otherfurniture"."""

SCANNET_CLASSES: Mapping[int, tuple[int, ...]] = MappingProxyType(
    {
        19: tuple(SCANNET_NAMES),
        15: (1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 12, 14, 16, 33, 34),
        10: (1, 2, 4, 5, 6, 7, 8, 9, 10, 33),
    }
)
"""OpenGaussian's lists of 19, 15 and 10 classes: `scripts/eval_scannet.py` (read in github.com/zhgulden/OpenGaussian-,
commit 478b2ef)."""

SCANNET_SCENES = tuple(
    f"scene{number}_00" for number in ("0000", "0062", "0070", "0097", "0140", "0200", "0347", "0400", "0590", "0645")
)
"""The ten scenes of OpenGaussian's table."""


@dataclass(frozen=True)
class PointFigures:
    """Figures over points.

    Attributes:
        miou: mean IoU of the classes that the truth has.
        macc: mean over those classes of the share of their points that are labelled right.
        accuracy: share of the labelled points that are labelled right.
        iou: by class name, of the classes that the truth has.
    """

    miou: float
    macc: float
    accuracy: float
    iou: Mapping[str, float]


def scannet_figures(
    truth: NDArray[np.integer],
    predicted: NDArray[np.integer],
    classes: int,
    opacities: NDArray[np.floating] | None = None,
) -> PointFigures:
    """OpenGaussian's figures of points of ScanNet; NaN where the truth has no class of the list.

    Points whose true class is not on the list, or whose Gaussian is nearly transparent, count neither for nor against
    anything. The means are over the classes that this scene shows.

    Args:
        truth: int [P], NYU40 ids, 0 = unlabelled.
        predicted: int [P], NYU40 ids of the list, or 0.
        classes: 19, 15 or 10.
        opacities: float [P], 0..1; points below 0.1 are left out. None leaves none out.

    Raises:
        InvalidInputError: arrays of different lengths, another number of classes, or a predicted id that is not on the
            list.
    """
    if classes not in SCANNET_CLASSES:
        raise InvalidInputError(f"a list of {classes} classes", field="classes", limit="19, 15 or 10")
    if truth.ndim != 1 or truth.shape != predicted.shape or (opacities is not None and opacities.shape != truth.shape):
        raise InvalidInputError(f"points {truth.shape} and {predicted.shape}", field="predicted", hint="Pass [P] each.")
    ids = SCANNET_CLASSES[classes]
    strangers = np.setdiff1d(predicted, (UNLABELED, *ids))
    if len(strangers):
        raise InvalidInputError(f"id {int(strangers[0])} is not on the list of {classes}", field="predicted")
    counted = np.isin(truth, ids)
    if opacities is not None:
        counted &= opacities >= _OPACITY_MIN
    counts = mask_counts(_rows(predicted[counted], ids), _rows(truth[counted], ids), classes)
    shown = counts.present()
    if not shown.any():
        return PointFigures(float("nan"), float("nan"), float("nan"), {})
    iou = counts.iou()
    return PointFigures(
        miou=counts.macro_iou(),
        macc=_mean_accuracy(counts),
        accuracy=counts.accuracy(),
        iou={SCANNET_NAMES[number]: float(iou[row]) for row, number in enumerate(ids, start=1) if shown[row]},
    )


def _rows(labels: NDArray[np.integer], ids: tuple[int, ...]) -> NDArray[np.int64]:
    """1.. in the order of `ids`, 0 for all others."""
    table = np.zeros(max(ids) + 1, np.int64)
    table[list(ids)] = np.arange(1, len(ids) + 1)
    return np.asarray(table[labels])


def _mean_accuracy(counts: MaskCounts) -> float:
    both, truth, _ = counts.counts[counts.present()].T
    return float((both / truth).mean())
