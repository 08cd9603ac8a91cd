"""The first draft of a scene: its objects are found, on few points and a moment of training."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fastsplat.service.common.dictionary import Dictionary
from fastsplat.service.instances.discovery_settings import DiscoverySettings
from fastsplat.service.jobs import create_scene
from fastsplat.service.jobs.drafts import first_draft
from fastsplat.service.perception.label_maps.capture_masks import propose_view_masks
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.results import Labelling, Regions
from fastsplat.service.settings import Settings
from fastsplat.service.splatting.labels.blending import object_map
from fastsplat_contract.jobs.job_watching import Provisional
from tests.instances.made_room import ColorSegmenter, NoDetector, make_room

_POINTS = 300


def test_objects_are_found_on_few_points_and_neither_described_nor_read(
    tmp_path: Path, models_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    room = make_room(tmp_path)
    views = room.capture.views
    rows = np.random.default_rng(0).choice(len(room.gaussians), _POINTS, replace=False)
    colors = np.full((_POINTS, 3), 128, np.uint8)
    capture = replace(room.capture, points=room.gaussians.means[rows], point_colors=colors)
    masks = propose_view_masks(
        views, NoDetector(), ColorSegmenter(), PerceptionSettings(min_pixels=8, closer_look=False)
    )
    blank = tuple(np.zeros_like(id_map, dtype=np.uint16) for id_map in room.maps)
    regions = tuple(Regions(id_map, ()) for id_map in blank)
    labelling = Labelling(Dictionary(()), blank, regions=regions, masks=masks)

    def fail(*_: object) -> None:
        raise AssertionError("a draft leaves that to the finished scene")

    monkeypatch.setattr(create_scene, "open_appearance_encoder", fail)
    monkeypatch.setattr(create_scene, "find_reader", fail)
    settings = Settings(data_dir=tmp_path, models=models_dir, discovery=DiscoverySettings(min_weight_px=5))
    scene = first_draft(capture, labelling, range(len(views)), settings)
    assert scene.facts.draft == Provisional("points", 0.0)
    assert scene.objects is not None
    owners = []
    for ball in (2, 3, 4):
        ids = [object_map(scene, view.posed)[id_map == ball] for view, id_map in zip(views, room.maps, strict=True)]
        counted = np.bincount(np.concatenate(ids))
        owners.append(int(counted.argmax()))
        assert owners[-1] and counted.max() > 0.5 * counted.sum()
    assert len(set(owners)) == 3
