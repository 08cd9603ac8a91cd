"""Which scenes get objects without being asked to: those whose photos models label."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from fastsplat.service.instances.discovery_settings import DiscoverySettings
from fastsplat.service.jobs.create_scene import build_scene, capture_folder
from fastsplat.service.scene.objects.object_codes import classes_of_codes, codes_of_objects
from fastsplat.service.scene.objects.objects import object_rows
from fastsplat.service.settings import Settings
from fastsplat.service.splatting.training_settings import TrainingSettings

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
