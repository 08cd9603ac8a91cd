"""One protocol for all methods: every figure by the functions of `service.evaluation`, on the same views and texts."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from benchmarks.methods.fields import DrawnField, Field
from fastsplat.service.evaluation.datasets.types import Dataset
from fastsplat.service.evaluation.image_quality import psnr
from fastsplat.service.evaluation.localization import box_of, peak_in_box
from fastsplat.service.evaluation.mask3d_iou import TrueSurface, gaussian_truth, mask3d_counts
from fastsplat.service.evaluation.predictions import silhouette, truth_ids
from fastsplat.service.evaluation.published.mask_pairs import (
    direct_selection,
    mask_iou,
    mean_over_pairs,
)
from fastsplat.service.evaluation.published.relevancy_maps import localized, thresholded_mask
from fastsplat.service.evaluation.segmentation import mask_counts, total
from fastsplat.service.evaluation.types import Skipped, mean
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.types import Gaussians
from fastsplat_contract.camera import PosedCamera

Colors = Callable[[PosedCamera], NDArray[np.uint8]]


class ProductField:
    """A scene of ours, asked as the product is.

    Args:
        index: the scene.
        dataset: whose labels are asked for.
    """

    def __init__(self, index: SceneIndex, dataset: Dataset) -> None:
        self._index = index
        self._to_truth = truth_ids(index.scene.dictionary, dataset.dictionary)
        self._answers = [index.ask([entry.label])[0] for entry in dataset.dictionary.entries]

    @property
    def classes(self) -> NDArray[np.int32]:
        """See `Field`."""
        return np.asarray(self._to_truth[self._index.gaussian_classes], np.int32)

    def draw(self, posed: PosedCamera) -> DrawnField:
        """See `Field`."""
        relevancy = np.stack([self._index.mask2d(answer, posed).relevancy for answer in self._answers])
        return DrawnField(np.asarray(self._to_truth[self._index.label_map(posed)], np.int32), relevancy)


def score(field: Field, gaussians: Gaussians, colors: Colors, dataset: Dataset) -> dict[str, float | None]:
    """Figures of the data set's measured views.

    Returns:
        psnr; miou (pooled pixels, by the label map); mask3d_iou, None without true depth; localization (LERF's, and
        LangSplat's with its mean filter); miou_langsplat (thresholded relevancy, mean over view and label);
        miou_opengaussian (Gaussians of the label drawn alone).
    """
    counts, qualities, surfaces = [], [], []
    peaks, filtered, cut, alone = [], [], [], []
    classes, labels = field.classes, len(dataset.dictionary)
    for view in dataset.test:
        if view.posed is None or view.labels is None or view.rgb is None:
            continue
        drawn, truth = field.draw(view.posed), view.labels
        counts.append(mask_counts(drawn.label_map, truth, labels, view.valid))
        quality = psnr(colors(view.posed).astype(np.float32) / 255, view.rgb.astype(np.float32) / 255, view.valid)
        qualities.extend([] if isinstance(quality, Skipped) else [quality])
        if view.depth is not None:
            surfaces.append(TrueSurface(view.posed, view.depth, truth))
        for label in np.unique(truth[truth > 0]).tolist():
            mask, relevancy = truth == label, drawn.relevancy[label - 1]
            box = box_of(mask)
            assert box is not None
            peaks.append(peak_in_box(relevancy, [box]))
            filtered.append(localized(relevancy, [box]))
            cut.append(mask_iou(thresholded_mask(relevancy), mask))
            alone.append(mask_iou(silhouette(gaussians, classes == label, view.posed), mask))
    truth3d = gaussian_truth(gaussians.means, surfaces, labels)
    return {
        "psnr": mean(qualities),
        "miou": total(counts).macro_iou(),
        "mask3d_iou": mask3d_counts(classes, truth3d, labels).macro_iou() if surfaces else None,
        "localization": float(np.mean(peaks)),
        "localization_langsplat": float(np.mean(filtered)),
        "miou_langsplat": mean_over_pairs(cut),
        "miou_opengaussian": direct_selection(alone).miou,
    }
