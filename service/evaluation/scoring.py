"""One test view against a scene: everything that is counted in it, before anything is averaged."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from fastsplat.service.common.dictionary import UNDETECTED, Dictionary
from fastsplat.service.evaluation.boundary import boundary_counts, mask_boundary_counts
from fastsplat.service.evaluation.datasets.types import QueryTruth, TrueView
from fastsplat.service.evaluation.depth import DepthErrors, depth_errors
from fastsplat.service.evaluation.ghosts import GhostCounts, ghost_counts
from fastsplat.service.evaluation.localization import box_of, peak_in_box, peak_in_mask
from fastsplat.service.evaluation.masks import MaskCounts
from fastsplat.service.evaluation.segmentation import mask_counts
from fastsplat.service.query import SceneIndex
from fastsplat.service.splatting.quality import psnr, ssim
from fastsplat_contract.queries import Answer


@dataclass(frozen=True)
class QueryScore:
    """One text in one view.

    Attributes:
        view: the image's name.
        text: what was asked.
        label_id: of the data set's dictionary.
        verdict: the answer's.
        answered: the label that leads the answer, "" if the scene has none.
        iou: of the pixels whose most probable label is the leading one; the text has to be one of the scene's labels.
        iou_threshold: of the mask the service answers with: empty when it says that nothing relevant is here.
        peak_in_box, peak_in_mask: of the relevancy map, see `service.evaluation.localization`.
    """

    view: str
    text: str
    label_id: int
    verdict: str
    answered: str
    iou: float
    iou_threshold: float
    peak_in_box: bool
    peak_in_mask: bool


@dataclass(frozen=True)
class ViewScore:
    """Counts of one view.

    Attributes:
        name: the image's name.
        closed: masks by closed-set argmax: every pixel has the most probable label of the scene, or none.
        threshold: masks that the service answers with, by the encoder's threshold; only labels that the truth shows
            here are asked for.
        boundary: of the closed-set masks.
        ghosts: None without a label map.
        queries: one a text that the truth shows here.
        psnr, ssim: over valid pixels; None when the view has no pose.
        depth: None without a depth map.
        predicted: int32 [H, W] closed-set ids of the data set's dictionary; None without a label map.
        rendered: uint8 [H, W, 3]; None when the view has no pose.
    """

    name: str
    closed: MaskCounts
    threshold: MaskCounts
    boundary: MaskCounts
    ghosts: GhostCounts | None
    queries: tuple[QueryScore, ...]
    psnr: float | None
    ssim: float | None
    depth: DepthErrors | None
    predicted: NDArray[np.int32] | None
    rendered: NDArray[np.uint8] | None


def score_view(
    index: SceneIndex,
    view: TrueView,
    dictionary: Dictionary,
    to_truth: NDArray[np.int32],
    answers: Mapping[str, Answer],
    *,
    diagonal_share: float,
) -> ViewScore:
    """Everything about one view. A view without a pose has missing predictions: empty masks, nothing pointed at.

    Args:
        index: the scene.
        view: the truth.
        dictionary: the data set's, N labels.
        to_truth: int32 [scene's labels + 1]: their ids in the data set's dictionary, 0 for those it does not have.
        answers: the scene's answer to every text of the view.
        diagonal_share: see `service.evaluation.boundary`.
    """
    posed, shape, labels = view.posed, _shape(view), len(dictionary)
    found = np.zeros(shape, np.uint16) if posed is None else index.label_map(posed)
    predicted = to_truth[found]
    rendered = None if posed is None else index.render(posed)
    closed, threshold, boundary = (np.zeros((labels + 1, 3), np.int64) for _ in range(3))
    ghosts = None
    if view.labels is not None:
        closed += mask_counts(predicted, view.labels, labels, view.valid).counts
        boundary += boundary_counts(predicted, view.labels, labels, view.valid, diagonal_share=diagonal_share).counts
        ghosts = ghost_counts(predicted, view.labels, labels, view.valid)
    queries = []
    for number, truth in _questions(view, dictionary):
        answer = answers[truth.text]
        lead = answer.matches[0] if answer.matches else None
        mask = found == lead.label_id if lead is not None else np.zeros(shape, np.bool_)
        answered = None if posed is None else index.mask2d(answer, posed)
        shown = np.zeros(shape, np.bool_) if answered is None else answered.mask
        relevancy = np.zeros(shape, np.float32) if answered is None else answered.relevancy
        one, other = _overlap(mask, truth.mask, view.valid), _overlap(shown, truth.mask, view.valid)
        threshold[number] += other
        if view.labels is None:
            closed[number] += one
            boundary[number] += mask_boundary_counts(mask, truth.mask, view.valid, diagonal_share=diagonal_share)
        queries.append(
            QueryScore(
                view=view.name,
                text=truth.text,
                label_id=number,
                verdict=answer.verdict,
                answered="" if lead is None else lead.label,
                iou=_iou(one),
                iou_threshold=_iou(other),
                peak_in_box=peak_in_box(relevancy, truth.boxes),
                peak_in_mask=peak_in_mask(relevancy, truth.mask),
            )
        )
    picture, structure = (None, None) if rendered is None else _picture(view, rendered)
    depth = None
    if view.depth is not None and posed is not None:
        depth = depth_errors(index.depth(posed), view.depth, view.valid)
    return ViewScore(
        name=view.name,
        closed=MaskCounts(closed),
        threshold=MaskCounts(threshold),
        boundary=MaskCounts(boundary),
        ghosts=ghosts,
        queries=tuple(queries),
        psnr=picture,
        ssim=structure,
        depth=depth,
        predicted=predicted if view.labels is not None else None,
        rendered=rendered,
    )


def texts_of(view: TrueView, dictionary: Dictionary) -> tuple[str, ...]:
    """What is asked in a view: its annotated texts, or the names of the labels in its map."""
    return tuple(truth.text for _, truth in _questions(view, dictionary))


def _questions(view: TrueView, dictionary: Dictionary) -> list[tuple[int, QueryTruth]]:
    """Dictionary ids and truths."""
    if view.labels is None:
        return [(dictionary.id_of(truth.text) or UNDETECTED, truth) for truth in view.queries]
    asked = []
    seen = view.labels if view.valid is None else np.where(view.valid, view.labels, UNDETECTED)
    for number in np.unique(seen).tolist():
        mask = seen == number
        box = box_of(mask)
        if number != UNDETECTED and box is not None:
            asked.append((int(number), QueryTruth(dictionary.label_of(int(number)), mask, (box,))))
    return asked


def _shape(view: TrueView) -> tuple[int, int]:
    if view.posed is not None:
        return view.posed.camera.height, view.posed.camera.width
    height, width = view.queries[0].mask.shape if view.queries else (1, 1)
    return height, width


def _overlap(
    predicted: NDArray[np.bool_], truth: NDArray[np.bool_], valid: NDArray[np.bool_] | None
) -> tuple[int, int, int]:
    if valid is not None:
        predicted, truth = predicted & valid, truth & valid
    return int((predicted & truth).sum()), int(truth.sum()), int(predicted.sum())


def _iou(counts: tuple[int, int, int]) -> float:
    both, truth, predicted = counts
    return both / max(1, truth + predicted - both)


def _picture(view: TrueView, rendered: NDArray[np.uint8]) -> tuple[float | None, float | None]:
    if view.rgb is None or (view.valid is not None and not view.valid.any()):
        return None, None
    image, target = (torch.tensor(pixels.astype(np.float32) / 255) for pixels in (rendered, view.rgb))
    valid = None if view.valid is None else torch.tensor(view.valid)
    return psnr(image, target, valid), ssim(image, target, valid)
