"""What a scene says of a test view, rendered and asked once for all metrics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields

import numpy as np
import torch
from numpy.typing import NDArray

from benchmarks.evaluation.datasets.dataset import QueryTruth, TrueView
from benchmarks.evaluation.localization import box_of
from benchmarks.evaluation.metrics import QueryPrediction, ViewPrediction
from benchmarks.evaluation.published.mask_pairs import silhouette_mask
from fastsplat.service.common.dictionary import UNDETECTED, Dictionary
from fastsplat.service.query.language.words.query_text import MAX_TEXTS
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.artefact.scene import Gaussians
from fastsplat.service.splatting.gaussians import splats_of
from fastsplat.service.splatting.raster.checks import device_of
from fastsplat.service.splatting.raster.image_formation import Backend
from fastsplat.service.splatting.raster.rendering import rasterize
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.messages.queries import Answer


def predict_view(
    index: SceneIndex,
    view: TrueView,
    dictionary: Dictionary,
    to_truth: NDArray[np.int32],
    answers: Mapping[str, Answer],
) -> ViewPrediction:
    """The scene's prediction for one view; of a view without a pose everything is missing.

    Args:
        index: the scene.
        view: the truth.
        dictionary: the data set's.
        to_truth: see `truth_ids`.
        answers: the scene's answer to every text of the view.
    """
    posed = view.posed
    labels = np.zeros(_size(view), np.uint16) if posed is None else index.label_map(posed)
    return ViewPrediction(
        truth=view,
        dictionary=dictionary,
        label_map=to_truth[labels],
        queries=tuple(
            _predict_query(index, view, labels, answers[truth.text], label_id, truth)
            for label_id, truth in _query_truths(view, dictionary)
        ),
        rgb=None if posed is None else index.render(posed),
        depth=None if posed is None or view.depth is None else index.depth(posed),
    )


def truth_ids(dictionary: Dictionary, truth: Dictionary) -> NDArray[np.int32]:
    """int32 [labels of `dictionary` + 1]: each label's id in `truth`, by name or alias; 0 for undetected and for labels
    that `truth` does not have."""
    names = [(entry.label, *entry.aliases) for entry in dictionary.entries]
    ids = [next((number for name in group if (number := truth.id_of(name))), UNDETECTED) for group in names]
    return np.array([UNDETECTED, *ids], np.int32)


def ask_all(index: SceneIndex, texts: Sequence[str]) -> list[Answer]:
    """Answers to any number of texts, in order."""
    step = MAX_TEXTS
    return [answer for start in range(0, len(texts), step) for answer in index.ask(texts[start : start + step])]


def texts_of(view: TrueView, dictionary: Dictionary) -> tuple[str, ...]:
    """What is asked in a view: its annotated texts, or the names of the labels in its map."""
    return tuple(truth.text for _, truth in _query_truths(view, dictionary))


def _predict_query(
    index: SceneIndex, view: TrueView, labels: NDArray[np.uint16], answer: Answer, label_id: int, truth: QueryTruth
) -> QueryPrediction:
    nothing = np.zeros(labels.shape, np.bool_)
    answered = None if view.posed is None else index.mask2d(answer, view.posed)
    return QueryPrediction(
        truth=truth,
        label_id=label_id,
        answer=answer,
        leading_mask=labels == answer.matches[0].label_id if answer.matches else nothing,
        answer_mask=nothing if answered is None else answered.mask,
        relevancy=np.zeros(labels.shape, np.float32) if answered is None else answered.relevancy,
        silhouette=nothing
        if view.posed is None
        else silhouette(index.scene.gaussians, index.mask3d(answer), view.posed, index.settings.backend),
    )


def silhouette(
    gaussians: Gaussians, selected: NDArray[np.bool_], posed: PosedCamera, backend: Backend = "cpu"
) -> NDArray[np.bool_]:
    """bool [H, W]: where the selected Gaussians [G] cover the view when drawn alone, see `silhouette_mask`."""
    device = device_of(backend)
    alone = Gaussians(**{item.name: getattr(gaussians, item.name)[selected] for item in fields(gaussians)})
    viewmat = torch.from_numpy(posed.camera_from_world().astype(np.float32)).to(device)
    drawn = rasterize(splats_of(alone, device=device), viewmat, posed.camera, backend=backend)
    return silhouette_mask(drawn.alpha.cpu().numpy())


def _query_truths(view: TrueView, dictionary: Dictionary) -> list[tuple[int, QueryTruth]]:
    """Dictionary ids and truths of the view's texts."""
    if view.labels is None:
        return [(dictionary.id_of(truth.text) or UNDETECTED, truth) for truth in view.queries]
    truths = []
    counted = view.labels if view.valid is None else np.where(view.valid, view.labels, UNDETECTED)
    for number in np.unique(counted).tolist():
        mask = counted == number
        box = box_of(mask)
        if number != UNDETECTED and box is not None:
            truths.append((int(number), QueryTruth(dictionary.label_of(int(number)), mask, (box,))))
    return truths


def _size(view: TrueView) -> tuple[int, int]:
    if view.posed is not None:
        return view.posed.camera.height, view.posed.camera.width
    height, width = view.queries[0].mask.shape if view.queries else (1, 1)
    return height, width
