"""Labelling of a capture: its dictionary and a label map per view."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PillowImage

from fastsplat.service.capture.build import load_image
from fastsplat.service.capture.captures import Capture, GivenLabels, View
from fastsplat.service.capture.formats.capture_files import load_content
from fastsplat.service.common.progress import Progress, ProgressEvent
from fastsplat.service.perception.detectors.open_detectors import of_open_set
from fastsplat.service.perception.label_maps.capture_detection import CaptureDetector, spread
from fastsplat.service.perception.label_maps.capture_masks import look_at_view
from fastsplat.service.perception.label_maps.detection_voting import detection_weights, region_votes, resolve_detections
from fastsplat.service.perception.label_maps.early_look import EARLY_VIEWS, ShowEarly, covering_order
from fastsplat.service.perception.label_maps.side_by_side import in_order, side_by_side
from fastsplat.service.perception.label_maps.vocabulary import (
    build_labelling,
    labelling_from_maps,
    merge_synonyms,
    synonyms,
)
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.results import Detections, Image, Labelling, Regions, ViewMasks
from fastsplat.service.perception.segmenters.mask_postprocessing import clean_mask, paint, resolve_overlaps
from fastsplat.service.perception.segmenters.open_segmenter import open_segmenter
from fastsplat.service.perception.text.text_encoders import open_text_encoder
from fastsplat_contract.errors import InvalidInputError

_SYNONYM_COSINE = 0.85
"""Least cosine of the name embeddings of synonyms; see `_SYNONYM_IOU`.

Names given by the user are never merged. 0.85 merges 7 of 30 pairs of one class.
"""
_SYNONYM_IOU = 0.5  # mean overlap of two classes over the views that show both, before rivals are resolved

_SEGMENTED_VIEW = {"closed": 20, "open": 3}
"""Time to segment a view in units of its detection, for the stage's progress."""


@dataclass(frozen=True)
class _ResolvedViews:
    """Detections of all views after the views were compared."""

    candidates: Sequence[Detections]  # of each view, all that score enough, under their entries' names
    objects: Sequence[Detections]  # of each view, those that the views support, one per object
    support: Mapping[str, float]  # of each class, see `resolve_detections`
    ids: Mapping[str, int]  # label id of each class, from 1
    aliases: Mapping[str, str]


def label_capture(
    capture: Capture,
    settings: PerceptionSettings,
    models: Path,
    labels: Sequence[str],
    progress: Progress,
    *,
    masks: bool = False,
    early: ShowEarly | None = None,
) -> Labelling:
    """Labels all views of a capture.

    Label maps of the capture are taken unchanged. Otherwise the views vote on the detections (`resolve_detections`),
    and boxes become masks and regions (`_segment_regions`) with the votes for rival names (`region_votes`), in an order
    in which views soon show most of the capture's points (`covering_order`).

    Args:
        labels: names to look for; empty: anything.
        progress: called for every view; may raise `CancelledError`.
        masks: also propose masks without names (`propose_masks`) from the same image features, unless label maps came
            with the capture.
        early: called once the first views are done (with `masks`, those with mask proposals that together show most);
            neither costs extra work nor changes the result.

    Returns:
        One label map per view, in order. Undetected throughout are views beyond `settings.max_views` or an open-set
        detector's time, and with `masks` those beyond `settings.proposal_views` that no class needs. The dictionary is
        empty if nothing is detected.

    Raises:
        InvalidInputError: labels unknown to the closed-set detector; label maps of a wrong size or with unknown ids.
        ModelUnavailableError: a configured model is missing, damaged or of another contract.
    """
    if capture.given_labels is not None:
        given = _read_labels(capture, capture.given_labels, progress)
        if early is not None:
            early(given, covering_order(capture, range(len(capture.views)))[:EARLY_VIEWS])
        return given
    positions = spread(len(capture.views), settings.max_views)
    # Opened first: a missing model should fail before minutes of detection.
    at_once, of_each = side_by_side(settings)
    segmenter = open_segmenter(of_each, models)

    def load(position: int) -> Image:
        return load_image(capture.views[positions[position]])

    proposing = set(spread(len(positions), settings.proposal_views)) if masks else set()
    rate = _SEGMENTED_VIEW["open" if settings.open_set_detector else "closed"]
    begin = len(positions) / (len(positions) + rate * len(proposing or positions))

    def on_view(done: int, message: str) -> None:
        progress(ProgressEvent("perception", begin * done / len(positions), message))

    proposed: list[ViewMasks | None] = [None] * (len(capture.views) if masks else 0)
    detector = CaptureDetector(load, len(positions), labels, settings, models, on_view)
    looked_at = [positions[position] for position in detector.limited()]
    if len(looked_at) < len(positions):
        positions, proposing = looked_at, set(spread(len(looked_at), settings.proposal_views)) if masks else set()
    resolved = _resolve(detector.detections(range(len(positions))), bool(labels), settings, models)
    maps = _LabelMaps(capture, resolved, settings)

    def labelled() -> Labelling:
        found, looked = maps.labelling(expected=bool(labels)), tuple(positions)
        name = settings.open_set_detector or settings.closed_set_detector
        return replace(found, masks=tuple(proposed), searched=detector.searched, looked_at=looked, detector=name)

    segmented = views_to_segment(resolved.objects, proposing) if masks else set(range(len(positions)))
    order = [positions.index(number) for number in covering_order(capture, positions)]
    first = [position for position in order if position in (proposing or segmented)][:EARLY_VIEWS]
    looked_at = [*first, *(position for position in order if position in segmented and position not in first)]

    def look(position: int) -> tuple[NDArray[np.bool_] | None, ViewMasks | None]:
        """Masks of a view's objects, and masks without names."""
        objects = resolved.objects[position]
        if position not in proposing:
            found = segmenter.masks(segmenter.embed(load(position)), objects.boxes) if len(objects) else None
            return found, None
        answers = look_at_view(segmenter, load(position), objects, resolved.candidates[position], settings)
        content = load_content(capture.views[positions[position]])
        return answers.masks_of_first(len(objects)), answers.masks if content is None else answers.masks.within(content)

    done = 0
    for some in (first, looked_at[len(first) :]):
        for position, (found, proposals) in zip(some, in_order(look, some, at_once), strict=True):
            done, number, count = done + 1, positions[position], len(resolved.objects[position])
            if masks:
                proposed[number] = proposals
            if found is not None:
                maps.add(number, position, found)
            message = f"segmenting {count} object{'s' if count != 1 else ''}, view {done}/{len(looked_at)}"
            progress(ProgressEvent("perception", begin + (1 - begin) * done / len(looked_at), message))
        if early is not None and some is first and 0 < done < len(looked_at):
            early(labelled(), [positions[position] for position in first])
    return labelled()


class _LabelMaps:
    """Regions and label maps, filled view by view."""

    def __init__(self, capture: Capture, resolved: _ResolvedViews, settings: PerceptionSettings) -> None:
        self._views, self._resolved, self._settings = capture.views, resolved, settings
        self._maps = [_blank(view) for view in capture.views]
        self._regions = [Regions(blank, ()) for blank in self._maps]

    def add(self, number: int, row: int, masks: NDArray[np.bool_]) -> None:
        """Labels view `number`, `row` of the resolved ones, by its objects' masks [K, H, W]."""
        objects, resolved, settings = self._resolved.objects[row], self._resolved, self._settings
        content = load_content(self._views[number])
        if len(objects) and content is not None:  # withheld pixels are no object, whatever their outline looks like
            inside = 2 * (masks & content).sum((1, 2)) >= masks.sum((1, 2))
            objects, masks = objects.take(np.flatnonzero(inside)), masks[inside]
        if not len(objects):
            return
        region_ids, rows = _segment_regions(masks, objects, resolved.support, settings)
        _blank_outside(region_ids, content)
        votes = region_votes(objects, resolved.candidates[row], resolved.ids, settings.rival_iou)
        self._regions[number] = Regions(region_ids, tuple(tuple(votes[detection].items()) for detection in rows))
        labels = np.array([0, *(resolved.ids[objects.labels[detection]] for detection in rows)], np.uint16)
        self._maps[number] = labels[region_ids]

    def labelling(self, *, expected: bool) -> Labelling:
        """Returns the labelling so far; `expected`: the user gave the names."""
        resolved = self._resolved
        return build_labelling(
            list(resolved.ids),
            self._maps,
            resolved.aliases,
            min_pixels=self._settings.min_pixels,
            regions=self._regions,
            expected=expected,
        )


def views_to_segment(objects: Sequence[Detections], proposing: set[int]) -> set[int]:
    """Positions of `proposing`, and of the best view for each class missing there."""
    proposed_labels = {label for position in proposing for label in objects[position].labels}
    best: dict[str, tuple[float, int]] = {}
    for position, view in enumerate(objects):
        for label, score in zip(view.labels, view.scores.tolist(), strict=True):
            if label not in proposed_labels:
                best[label] = max(best.get(label, (0.0, position)), (score, position))
    return proposing | {position for _, position in best.values()}


def _resolve(
    detections: Sequence[Detections], named: bool, settings: PerceptionSettings, models: Path
) -> _ResolvedViews:
    """Resolves detections under their entries' names; names `named` by the user are no synonyms."""
    thresholds = _thresholds(settings)
    aliases: dict[str, str] = {}
    if settings.open_set_detector and not named:
        encoder = open_text_encoder(settings.text_encoder, models, threads=settings.threads)
        with_rivals = thresholds.model_copy(update={"rival_iou": 1.0})
        believed = resolve_detections(detections, with_rivals, named=False)[0]
        aliases = synonyms(believed, encoder, cosine=_SYNONYM_COSINE, iou=_SYNONYM_IOU)
        detections = merge_synonyms(detections, aliases)
    objects, support = resolve_detections(detections, thresholds, named=named)
    classes = dict.fromkeys(label for view in objects for label in view.labels)
    if named:  # a requested name that loses every box to rivals may still win when the views vote again
        classes |= dict.fromkeys(label for view in detections for label in view.labels)
    return _ResolvedViews(
        candidates=[view.take(np.flatnonzero(view.scores >= thresholds.score_floor)) for view in detections],
        objects=objects,
        support=support,
        ids={label: label_id for label_id, label in enumerate(classes, start=1)},
        aliases=aliases,
    )


def _thresholds(settings: PerceptionSettings) -> PerceptionSettings:
    return of_open_set(settings) if settings.open_set_detector else settings


def _segment_regions(
    masks: NDArray[np.bool_], objects: Detections, support: Mapping[str, float], settings: PerceptionSettings
) -> tuple[NDArray[np.uint16], list[int]]:
    """Numbers masks as regions 1..R, uint16 [H, W]; also returns each region's mask number."""
    weights = detection_weights(objects, support)
    cleaned = np.stack([clean_mask(mask) for mask in masks])
    large = np.flatnonzero(cleaned.sum((1, 2)) >= settings.min_pixels)
    winners = resolve_overlaps(
        cleaned[large], [objects.labels[row] for row in large], weights[large], settings.rival_iou
    )
    rows = large[winners]
    return paint(cleaned[rows], range(1, len(rows) + 1), weights[rows]), rows.tolist()


def _read_labels(capture: Capture, labels: GivenLabels, progress: Progress) -> Labelling:
    maps = []
    for view, path in zip(capture.views, labels.map_paths, strict=True):
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
        _blank_outside(maps[-1], load_content(view))
    progress(ProgressEvent("perception", 1.0, f"{len(maps)} label maps came with the capture"))
    return labelling_from_maps(labels.dictionary, maps)


def _blank(view: View) -> NDArray[np.uint16]:
    return np.zeros((view.posed.camera.height, view.posed.camera.width), np.uint16)


def _blank_outside(label_map: NDArray[np.uint16], content: NDArray[np.bool_] | None) -> None:
    """Sets pixels without content to 0: undistortion margins, masked and withheld pixels."""
    if content is not None:
        label_map[~content] = 0
