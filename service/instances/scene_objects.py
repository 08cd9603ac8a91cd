"""Instance segmentation of a trained scene: discovery without a vocabulary, then naming by labels."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from fastsplat.service.capture.captures import Capture, View
from fastsplat.service.instances.discovery.coded_objects import fit_object_codes
from fastsplat.service.instances.discovery.discovery import OnView, discover_objects, masked_view
from fastsplat.service.instances.discovery.lifting import lift_regions_of
from fastsplat.service.instances.discovery_settings import DiscoverySettings
from fastsplat.service.instances.naming.name_models import NameModel
from fastsplat.service.instances.naming.naming import NameVotes, count_votes, name_objects
from fastsplat.service.perception.results import Labelling, Regions, ViewMasks
from fastsplat.service.scene.artefact.scene import Gaussians, Objects, SceneFacts
from fastsplat.service.scene.artefact.upright import up_of, vertical_of
from fastsplat.service.splatting.gaussians import splats_of
from fastsplat.service.splatting.labels.region_groups import LiftedRegions
from fastsplat.service.splatting.raster.checks import device_of
from fastsplat.service.splatting.raster.image_formation import Backend
from fastsplat.service.splatting.training_settings import TrainingSettings
from fastsplat.service.splatting.training_views import training_size

NAME_OVERLAP = 0.5
"""Least overlap of a region with the object that it names, in its view."""

_SPECK_PX = 16
_TRAINING = TrainingSettings()


def find_scene_objects(
    gaussians: Gaussians,
    capture: Capture,
    labelling: Labelling,
    masks: Sequence[ViewMasks | None],
    settings: DiscoverySettings,
    on_view: OnView = lambda done, total: None,
    *,
    training: TrainingSettings = _TRAINING,
    name_model: NameModel | None = None,
) -> tuple[Objects, Gaussians]:
    """Finds and names the objects of a scene; also returns its Gaussians with object codes.

    Args:
        gaussians: G of them, trained on the capture.
        labelling: detections or given label maps; an empty dictionary names nothing.
        masks: of each view, without names, see `propose_capture_masks`.
        on_view: called for every view whose masks are lifted.
        training: for backend, seed and `code_size`.
        name_model: of the detector that labelled; None: its names are suggestions.
    """
    recorded = capture.report.vertical
    facts = SceneFacts()
    if recorded is not None:
        facts = SceneFacts(vertical_source=recorded.source, vertical_deviation_deg=recorded.deviation_deg)
    up = up_of(vertical_of(facts, None, [view.posed for view in capture.views]))
    backend = training.backend
    objects = discover_objects(gaussians, capture.views, masks, up, settings, on_view, backend=backend).objects
    pairs = zip(capture.views, masks, strict=True)
    seen = [masked_view(view, view_masks, settings) for view, view_masks in pairs if view_masks is not None]
    fitted = fit_object_codes(
        objects, gaussians, seen, settings, size=training.code_size, seed=training.seed, backend=backend
    )
    if fitted is not None:
        objects, gaussians = replace(objects, head=fitted[1]), replace(gaussians, codes=fitted[0])
    return _named(objects, gaussians, capture, labelling, settings, backend, name_model), gaussians


def _named(
    objects: Objects,
    gaussians: Gaussians,
    capture: Capture,
    labelling: Labelling,
    settings: DiscoverySettings,
    backend: Backend,
    name_model: NameModel | None,
) -> Objects:
    names = [entry.label for entry in labelling.dictionary.entries]
    if not names or not objects.table:
        return objects
    regions = labelling.regions or [regions_of_label_map(label_map) for label_map in labelling.label_maps]
    used = [pair for pair in zip(capture.views, regions, strict=True) if pair[1].votes]
    votes = votes_of_views(objects, gaussians, used, len(names), settings, backend=backend)
    return name_objects(objects, votes, names, "given" if labelling.exact else "detected", name_model)


@torch.no_grad()
def votes_of_views(
    objects: Objects,
    gaussians: Gaussians,
    used: Sequence[tuple[View, Regions]],
    labels: int,
    settings: DiscoverySettings,
    *,
    backend: Backend = "cpu",
) -> NameVotes:
    """Counts the votes of `used` views' regions for `labels` names, see `count_votes`."""
    lifted, regions = _lifted(gaussians, used, settings, backend), [seen for _, seen in used]
    return count_votes(objects, lifted, regions, labels, min_overlap=NAME_OVERLAP)


def regions_of_label_map(label_map: NDArray[np.uint16]) -> Regions:
    """Makes each label's connected areas regions with score 1, without specks."""
    ids = np.zeros(label_map.shape, np.uint16)
    votes: list[tuple[tuple[int, float], ...]] = []
    for label in np.unique(label_map[label_map > 0]).tolist():
        mask = (label_map == label).astype(np.uint8)
        count, areas, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
        large = stats[:, cv2.CC_STAT_AREA] >= _SPECK_PX
        large[0] = False
        number = np.zeros(count, np.uint16)
        number[large] = np.arange(len(votes) + 1, len(votes) + 1 + large.sum())
        ids += number[areas]
        votes += [((label, 1.0),)] * int(large.sum())
    return Regions(ids, tuple(votes))


def _lifted(
    gaussians: Gaussians, used: Sequence[tuple[View, Regions]], settings: DiscoverySettings, backend: Backend
) -> Iterator[LiftedRegions]:
    splats = splats_of(gaussians, device=device_of(backend))
    for view, regions in used:
        camera = training_size(view.posed.camera, settings.max_side)
        viewmat = torch.from_numpy(view.posed.camera_from_world().astype(np.float32))
        ids = regions.resized(camera.width, camera.height)
        yield lift_regions_of(splats, viewmat, camera, ids, len(regions.votes), backend=backend)
