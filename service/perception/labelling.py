"""The room's main work: a capture in, a dictionary and label maps out."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PillowImage

from fastsplat.service.capture import load_image
from fastsplat.service.capture.types import Capture, GivenLabels, View
from fastsplat.service.common.progress import Progress, ProgressEvent
from fastsplat.service.perception.finding import find
from fastsplat.service.perception.maps import clean_mask, paint, settle_masks
from fastsplat.service.perception.segmenters import open_segmenter
from fastsplat.service.perception.settings import PerceptionSettings
from fastsplat.service.perception.text import open_text_encoder
from fastsplat.service.perception.types import Detections, Image, Labelling, Regions
from fastsplat.service.perception.vocabulary import counted, finished, renamed, synonyms
from fastsplat.service.perception.votes import settle, votes_for, weights
from fastsplat_contract.errors import InvalidInputError

_FINDING = 0.3  # share of the stage's progress; segmentation takes the rest


def label_capture(
    capture: Capture, settings: PerceptionSettings, models: Path, labels: Sequence[str], progress: Progress
) -> Labelling:
    """Name the pixels of every view.

    Label maps that came with the capture are taken as they are, and no model runs. Otherwise every view is searched
    first (see `finding.find`), then the views together decide what is in the scene (`votes.settle`), then boxes become
    masks, rivals for the same pixels are settled, and overlaps go to the smaller mask (`maps.paint`). What the losing
    rivals were called is kept with each region: once there is geometry, the views vote again.

    Args:
        capture: registered images.
        settings: models and thresholds.
        models: the model directory.
        labels: names to look for; empty: whatever is there.
        progress: hears of every view; may raise `CancelledError`.

    Returns:
        One label map per view, in order. With `settings.max_views`, views that were not looked at are undetected
        throughout. A scene in which nothing is found has an empty dictionary.

    Raises:
        InvalidInputError: labels the closed-set detector cannot know; given maps of a wrong size or with unknown ids.
        ModelUnavailableError: a configured model is missing, damaged or of another contract.
    """
    if capture.given_labels is not None:
        return _given(capture, capture.given_labels, progress)
    total = len(capture.views)
    looked_at = _spread(total, settings.max_views)
    # Opened first: a missing model should fail before minutes of detection.
    segmenter = open_segmenter(settings, models)

    def load(position: int) -> Image:
        return load_image(capture.views[looked_at[position]])

    def seen(done: int, message: str) -> None:
        progress(ProgressEvent("perception", _FINDING * done / len(looked_at), message))

    found = find(load, len(looked_at), labels, settings, models, seen)
    rules = settings.of_open_set() if settings.open_set_detector else settings
    aliases: dict[str, str] = {}
    if settings.synonym_cosine < 1 and settings.open_set_detector and not labels:
        encoder = open_text_encoder(settings.text_encoder, models, threads=settings.threads)
        believed = settle(found, rules.model_copy(update={"rival_iou": 1.0}), named=False)[0]
        aliases = synonyms(believed, encoder, cosine=settings.synonym_cosine, iou=settings.synonym_iou)
        found = renamed(found, aliases)
    settled, support = settle(found, rules, named=bool(labels))
    shown = dict.fromkeys(kind for view in settled for kind in view.labels)
    # A name that was asked for may lose every box to a rival; when the views vote it may win after all.
    heard = dict.fromkeys(kind for view in found for kind in view.labels) if labels else {}
    ids = {kind: i for i, kind in enumerate({**shown, **heard}, start=1)}

    maps = [_blank(view) for view in capture.views]
    regions = [Regions(blank, ()) for blank in maps]
    for position, view_index in enumerate(looked_at):
        view = capture.views[view_index]
        detections = settled[position]
        if len(detections):
            image = load(position)
            masks = segmenter.masks(segmenter.embed(image), detections.boxes)
            likely = found[position].take(np.flatnonzero(found[position].scores >= rules.score_floor))
            votes = votes_for(detections, likely, ids, settings.rival_iou)
            maps[view_index], regions[view_index] = _label_map(
                masks, detections, weights(detections, support), votes, ids, settings
            )
            _blank_outside(maps[view_index], view)
            _blank_outside(regions[view_index].ids, view)
        fraction = _FINDING + (1 - _FINDING) * (position + 1) / len(looked_at)
        things = f"{len(detections)} thing{'s' if len(detections) != 1 else ''}"
        progress(ProgressEvent("perception", fraction, f"cutting out {things}, view {position + 1}/{len(looked_at)}"))
    return finished(list(ids), maps, aliases, min_pixels=settings.min_pixels, regions=regions, expected=bool(labels))


def _label_map(
    masks: NDArray[np.bool_],
    detections: Detections,
    strength: NDArray[np.float32],
    votes: list[dict[int, float]],
    ids: dict[str, int],
    settings: PerceptionSettings,
) -> tuple[NDArray[np.uint16], Regions]:
    cleaned = np.stack([clean_mask(mask) for mask in masks])
    large = np.flatnonzero(cleaned.sum((1, 2)) >= settings.min_pixels)
    kinds = [detections.labels[row] for row in large]
    cleaned, strength, votes = cleaned[large], strength[large], [votes[row] for row in large]
    kept = settle_masks(cleaned, kinds, strength, settings.rival_iou)
    painted = paint(cleaned[kept], range(1, len(kept) + 1), strength[kept])
    names = np.array([0, *(ids[kinds[row]] for row in kept)], np.uint16)
    return names[painted], Regions(painted, tuple(tuple(votes[row].items()) for row in kept))


def _given(capture: Capture, given: GivenLabels, progress: Progress) -> Labelling:
    maps = []
    for view, path in zip(capture.views, given.map_paths, strict=True):
        if path is None:
            maps.append(_blank(view))
            continue
        with PillowImage.open(path) as picture:
            label_map = np.asarray(picture)
        if label_map.shape != (view.posed.camera.height, view.posed.camera.width):
            raise InvalidInputError(
                f"the label map of {view.posed.name} is {label_map.shape}, its image "
                f"{(view.posed.camera.height, view.posed.camera.width)} (height, width)",
                field=f"labels/{path.name}",
                hint="Label maps are single-channel images of their view's size.",
            )
        maps.append(label_map.astype(np.uint16))
        _blank_outside(maps[-1], view)
    progress(ProgressEvent("perception", 1.0, f"{len(maps)} label maps came with the capture"))
    return counted(given.dictionary, maps)


def _spread(total: int, limit: int) -> list[int]:
    """Positions of at most `limit` of `total` views, evenly spread, first and last included; 0: all."""
    if not limit or limit >= total:
        return list(range(total))
    return sorted({round(position) for position in np.linspace(0, total - 1, limit)})


def _blank(view: View) -> NDArray[np.uint16]:
    return np.zeros((view.posed.camera.height, view.posed.camera.width), np.uint16)


def _blank_outside(label_map: NDArray[np.uint16], view: View) -> None:
    """Undistortion leaves margins without content; nothing is there to be named."""
    if view.valid_path is not None:
        with PillowImage.open(view.valid_path) as picture:
            label_map[np.asarray(picture.convert("L")) < 128] = 0
