"""Which scenes get objects without being asked to, and that their first draft has them."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fastsplat.service.common.dictionary import Dictionary
from fastsplat.service.instances.discovery_settings import DiscoverySettings
from fastsplat.service.jobs import create_scene
from fastsplat.service.jobs.create_scene import build_scene, capture_folder
from fastsplat.service.jobs.drafts import first_draft
from fastsplat.service.perception.label_maps.capture_masks import propose_view_masks
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.results import Labelling, Regions
from fastsplat.service.scene.objects.object_codes import classes_of_codes, codes_of_objects
from fastsplat.service.scene.objects.objects import object_rows
from fastsplat.service.settings import Settings
from fastsplat.service.splatting.labels.blending import object_map
from fastsplat.service.splatting.training_settings import TrainingSettings
from fastsplat_contract.jobs.job_watching import Provisional
from tests.instances.made_room import ColorSegmenter, NoDetector, make_room

_SAMPLE = Path(__file__).resolve().parents[2] / "demo" / "sample"
_VIEWS = 3


@pytest.fixture
def settings(models_dir: Path) -> Settings:
    training = TrainingSettings(iterations=60, time_budget_s=None, max_gaussians=2_000, max_side=256, held_out_every=0)
    return Settings(models=models_dir, training=training)


def _photos(folder: Path) -> Path:
    """A few neighboring photos of the sample with their poses, and no labels."""
    document = json.loads((_SAMPLE / "transforms.json").read_text())
    posed = {key: value for key, value in document.items() if key not in ("labels", "split")}
    posed["frames"] = [
        {key: frame[key] for key in ("file_path", "transform_matrix")} for frame in document["frames"][:_VIEWS]
    ]
    folder.mkdir()
    (folder / "transforms.json").write_text(json.dumps(posed))
    for frame in posed["frames"]:
        target = folder / frame["file_path"]
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(_SAMPLE / frame["file_path"], target)
    return folder


@pytest.mark.parametrize("objects", ["auto", "off"])
def test_photos_that_models_label_give_objects_with_and_without_names(
    settings: Settings, tmp_path: Path, objects: str
) -> None:
    used = settings.model_copy(update={"discovery": DiscoverySettings(objects=objects)})
    capture = capture_folder(_photos(tmp_path / "photos"), tmp_path / "capture", used.capture)
    scene = build_scene(capture, used).scene
    assert scene.objects is not None and scene.label_mode == "objects"
    assert scene.objects.head is not None
    owner = object_rows(scene.objects)
    coded = codes_of_objects(scene.gaussians.codes, scene.objects.head, owner)
    said = coded.ids[classes_of_codes(coded.codes, coded.head)[0]]
    assert (said == owner).mean() > 0.95, "the code of a Gaussian says which object it is"
    assert len(scene.objects.table) >= (1 if objects == "off" else 3)
    unknown = [obj for obj in scene.objects.table if not obj.name and not obj.suggestions]
    # Three small photos: what the detector finds may be too unsure for a name or a suggestion.
    assert unknown if objects == "auto" else 2 * len(unknown) < len(scene.objects.table), "off: what the detector finds"
    assert {obj.source for obj in scene.objects.table} <= {None, "detected"}


@pytest.mark.parametrize(
    ("objects", "given_labels", "proposes"),
    [
        ("auto", False, True), ("auto", True, False), ("on", False, True),
        ("on", True, True), ("off", False, False), ("off", True, False),
    ],
)  # fmt: skip
def test_given_label_maps_need_no_models(objects: str, given_labels: bool, proposes: bool) -> None:
    settings = DiscoverySettings(objects=objects)
    assert settings.proposes(given_labels=given_labels) == proposes


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
