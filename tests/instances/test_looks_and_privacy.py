"""An image-text model looks at the objects of new scenes where photos may be kept, and at nothing of others."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fastsplat.service.capture.capture_settings import PhotoSettings
from fastsplat.service.capture.captures import WithheldReport
from fastsplat.service.common.dictionary import Dictionary
from fastsplat.service.common.progress import silent
from fastsplat.service.jobs.create_scene import assemble_scene, find_objects
from fastsplat.service.perception.image_text import open_image_text
from fastsplat.service.perception.label_maps.capture_masks import propose_view_masks
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.results import Labelling
from fastsplat.service.query.language.meaning.common_objects import all_common_objects
from fastsplat.service.query.phrases.looks_files import save_calibration
from fastsplat.service.scene.artefact.scene import SceneFacts, SemanticHead
from fastsplat.service.settings import Settings
from fastsplat.service.splatting.results import TrainedSplats
from tests.instances.made_room import ColorSegmenter, NoDetector, Room
from tests.instances.test_discovery import PERCEPTION, SETTINGS
from tests.looks_model import COLORS, MODEL, calibration_of, write_looks_model


@pytest.fixture
def settings(tmp_path: Path, models_dir: Path) -> Settings:
    write_looks_model(tmp_path)
    for name in ("picodet_416", "minilm_l6_int8"):
        (tmp_path / name).symlink_to(models_dir / name)
    perception = PerceptionSettings(image_text=MODEL, reader="")
    return Settings(models=tmp_path, perception=perception, discovery=SETTINGS.model_copy(update={"objects": "on"}))


def _unnamed(room: Room) -> tuple[TrainedSplats, Labelling]:
    masks = propose_view_masks(room.capture.views, NoDetector(), ColorSegmenter(), PERCEPTION)
    return TrainedSplats(room.gaussians, SemanticHead.unlearnt(0), {}, ()), Labelling(Dictionary(()), (), masks=masks)


def _looked_at(room: Room, settings: Settings) -> list[bool]:
    objects, _ = find_objects(*_unnamed(room), room.capture, settings, silent)
    assert objects is not None and all(obj.appearance for obj in objects.table)
    return [obj.looks is not None for obj in objects.table]


def test_looks_are_kept_unless_photos_are_not_or_people_are_withheld(room: Room, settings: Settings) -> None:
    assert all(_looked_at(room, settings))
    assert not any(_looked_at(room, settings.model_copy(update={"photos": PhotoSettings(keep="off")})))
    report = replace(room.capture.report, withheld=WithheldReport("people", 0, 0.0))
    assert not any(_looked_at(replace(room, capture=replace(room.capture, report=report)), settings))


def test_a_scene_bears_the_names_that_its_looks_give(room: Room, settings: Settings) -> None:
    colors = dict(zip(("tomato", "cucumber", "balloon"), COLORS.values(), strict=True))
    rows = np.array([colors.get(obj.names[0], (0.1, 0.1, 0.1)) for obj in all_common_objects()])
    common = (rows / np.linalg.norm(rows, axis=1, keepdims=True)).astype(np.float16)
    model = open_image_text(settings.perception, settings.models)
    save_calibration(calibration_of(model), common, settings.models)
    scene = assemble_scene(*_unnamed(room), room.capture, settings, SceneFacts(), {})
    assert scene.objects is not None
    named = {obj.name for obj in scene.objects.table if obj.name}
    assert named == colors.keys() == {entry.label for entry in scene.dictionary.entries}
    assert len(scene.head.bias) == 1 + len(scene.label_embeddings) == 1 + len(colors)
