"""Masks without names for the views of a capture that is not labelled by models."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from fastsplat.service.capture.build import load_image
from fastsplat.service.capture.captures import View
from fastsplat.service.capture.formats.capture_files import load_content
from fastsplat.service.perception.detectors.open_detectors import open_closed_set_detector
from fastsplat.service.perception.label_maps.capture_detection import detect_closed_set, spread
from fastsplat.service.perception.label_maps.side_by_side import in_order, side_by_side
from fastsplat.service.perception.label_maps.view_answers import look_at_view
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.results import ClosedSetDetector, Segmenter, ViewMasks
from fastsplat.service.perception.segmenters.open_segmenter import open_segmenter

OnView = Callable[[int, int], None]
"""Called with the number of views done and their total; may raise `CancelledError`."""


def propose_capture_masks(
    views: Sequence[View], settings: PerceptionSettings, models: Path, on_view: OnView = lambda done, total: None
) -> tuple[ViewMasks | None, ...]:
    """Proposes masks in at most `proposal_views` evenly spread views; None for the others.

    Raises:
        ModelUnavailableError: the closed-set detector or the segmenter is missing or damaged.
    """
    _, of_each = side_by_side(settings)
    detector, segmenter = open_closed_set_detector(of_each, models), open_segmenter(of_each, models)
    return propose_view_masks(views, detector, segmenter, settings, on_view)


def propose_view_masks(
    views: Sequence[View],
    detector: ClosedSetDetector,
    segmenter: Segmenter,
    settings: PerceptionSettings,
    on_view: OnView = lambda done, total: None,
) -> tuple[ViewMasks | None, ...]:
    """Proposes masks as `propose_capture_masks`, by these models; the detector's labels are ignored."""
    positions = spread(len(views), settings.proposal_views)
    masks: list[ViewMasks | None] = [None] * len(views)

    def look(position: int) -> ViewMasks:
        image = load_image(views[position])
        detections = detect_closed_set(detector, image, settings)
        proposed = look_at_view(segmenter, image, detections.take([]), detections, settings).masks
        content = load_content(views[position])
        return proposed if content is None else proposed.within(content)

    at_once, _ = side_by_side(settings)
    for done, (position, found) in enumerate(zip(positions, in_order(look, positions, at_once), strict=True), start=1):
        masks[position] = found
        on_view(done, len(positions))
    return tuple(masks)
