"""A data set's training views become a scene as a job makes it, by labels from where it is asked for."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks.evaluation.datasets.reading import read_dataset
from benchmarks.evaluation.scene_evaluation import evaluate_scene
from benchmarks.evaluation.train_eval import TrainingLabels, train_on_split
from benchmarks.evaluation.validation_split import Split
from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.instances.discovery_settings import DiscoverySettings
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.scene.artefact.scene import Scene
from fastsplat.service.settings import Settings
from fastsplat.service.splatting.training_settings import TrainingSettings
from fastsplat_contract.errors import InvalidInputError
from tests.benchmarks.evaluation import made_data


@pytest.fixture
def settings(models_dir: Path) -> Settings:
    return Settings(
        models=models_dir,
        training=TrainingSettings(iterations=40, max_gaussians=200, time_budget_s=60),
        perception=PerceptionSettings(max_views=2, proposal_views=2, min_pixels=8),
        discovery=DiscoverySettings(min_weight_px=4.0),
    )


def _trained(folder: Path, work: Path, settings: Settings, labels: TrainingLabels, split: Split = "test") -> Scene:
    dataset = read_dataset(folder, CaptureSettings(), split=split)
    return train_on_split(dataset, settings, work / "work", labels=labels).scene


def test_masks_without_labels_for_training_are_asked_for(settings: Settings, tmp_path: Path) -> None:
    folder = made_data.three_d_ovs(tmp_path / "bed", 5, ["01"])
    with pytest.raises(InvalidInputError) as refused:
        _trained(folder, tmp_path, settings, "given")
    assert "--labels detected" in refused.value.hint


def test_detected_labels_leave_the_data_sets_own_maps_alone(settings: Settings, tmp_path: Path) -> None:
    folder = made_data.nerfstudio(tmp_path / "made", 4, (1,))
    document = json.loads((folder / "transforms.json").read_text())
    document["labels"] = {"cup": 1, "spoon": 2, "bed": 3}  # names that the default detector knows
    (folder / "transforms.json").write_text(json.dumps(document))
    scene = _trained(folder, tmp_path, settings, "detected")
    report = evaluate_scene(made_data.index(scene), read_dataset(folder, CaptureSettings()))
    assert report.figures["miou"] == 0  # balls are no cups


def test_photos_alone_become_a_scene_that_is_validated_without_the_test_views(
    settings: Settings, tmp_path: Path
) -> None:
    """The names of the data set, which the default detector does not know, are not asked for."""
    folder = made_data.nerfstudio(tmp_path / "made", 6, (1,))
    scene = _trained(folder, tmp_path, settings, "default", "validation")
    (validated,) = read_dataset(folder, CaptureSettings(), split="validation").test
    names = {camera.name for camera in scene.cameras}
    assert len(names) == 4 and not {validated.name, "images/001.png"} & names
    assert not {entry.label for entry in scene.dictionary.entries} & set(made_data.LABELS)


def test_objects_are_discovered_without_any_label(settings: Settings, tmp_path: Path) -> None:
    scene = _trained(made_data.nerfstudio(tmp_path / "made", 6, (1, 4)), tmp_path, settings, "discovered")
    assert scene.objects is not None and len(scene.dictionary) == 0
    assert all(obj.name == "" for obj in scene.objects.table)
