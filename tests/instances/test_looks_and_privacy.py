"""An image-text model looks at the objects of new scenes where photos may be kept, and at nothing of others."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from fastsplat.service.capture.capture_settings import PhotoSettings
from fastsplat.service.capture.captures import WithheldReport
from fastsplat.service.common.dictionary import Dictionary
from fastsplat.service.common.progress import silent
from fastsplat.service.jobs.create_scene import find_objects
from fastsplat.service.perception.label_maps.capture_masks import propose_view_masks
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.results import Labelling
from fastsplat.service.scene.artefact.scene import SemanticHead
from fastsplat.service.settings import Settings
from fastsplat.service.splatting.results import TrainedSplats
from tests.instances.made_room import ColorSegmenter, NoDetector, Room
from tests.instances.test_discovery import PERCEPTION, SETTINGS
from tests.looks_model import MODEL, write_looks_model


@pytest.fixture
def settings(tmp_path: Path, models_dir: Path) -> Settings:
    write_looks_model(tmp_path)
    (tmp_path / "picodet_416").symlink_to(models_dir / "picodet_416")
    perception = PerceptionSettings(image_text=MODEL, reader="")
    return Settings(models=tmp_path, perception=perception, discovery=SETTINGS.model_copy(update={"objects": "on"}))


def _looked_at(room: Room, settings: Settings) -> list[bool]:
    masks = propose_view_masks(room.capture.views, NoDetector(), ColorSegmenter(), PERCEPTION)
    trained = TrainedSplats(room.gaussians, SemanticHead.unlearnt(0), {}, ())
    objects, _ = find_objects(trained, Labelling(Dictionary(()), (), masks=masks), room.capture, settings, silent)
    assert objects is not None and all(obj.appearance for obj in objects.table)
    return [obj.looks is not None for obj in objects.table]


def test_looks_are_kept_unless_photos_are_not_or_people_are_withheld(room: Room, settings: Settings) -> None:
    assert all(_looked_at(room, settings))
    assert not any(_looked_at(room, settings.model_copy(update={"photos": PhotoSettings(keep="off")})))
    report = replace(room.capture.report, withheld=WithheldReport("people", 0, 0.0))
    assert not any(_looked_at(replace(room, capture=replace(room.capture, report=report)), settings))
