"""A data set's training views become a scene as a job makes it: a worker, the evaluation and a library user agree."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.evaluation.datasets.reading import read_dataset
from benchmarks.evaluation.scene_evaluation import evaluate_scene
from benchmarks.evaluation.train_eval import TrainingLabels, train_on_split
from benchmarks.evaluation.validation_split import Split
from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.captures import Capture, CaptureReport, View
from fastsplat.service.capture.uploads.upload_validation import validate_upload
from fastsplat.service.common.dictionary import dictionary_of
from fastsplat.service.common.progress import silent
from fastsplat.service.instances.discovery_settings import DiscoverySettings
from fastsplat.service.jobs.create_scene import build_scene, capture_folder, scene_facts, scene_quality
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.results import Labelling
from fastsplat.service.planning.presets import PresetName
from fastsplat.service.scene.artefact.scene import Scene
from fastsplat.service.scene.artefact.scene_facts import SceneFacts, split_quality
from fastsplat.service.scene.artefact.scene_files import read_scene, write_scene
from fastsplat.service.settings import Settings
from fastsplat.service.splatting.results import TrainedSplats
from fastsplat.service.splatting.training_settings import TrainingSettings
from fastsplat.workers.job.protocol import Job
from fastsplat.workers.job.results import finish_stage, start_stage
from fastsplat.workers.kinds.create_scene import STAGES
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.jobs.operations import SceneOptions
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
    labels = {"cup": 1, "spoon": 2, "bed": 3}  # names that the default detector knows
    made_data.change_json(folder / "transforms.json", lambda document: document.update(labels=labels))
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


TEST_VIEWS = (1, 4)


@pytest.fixture
def exact_settings(models_dir: Path) -> Settings:
    """Short runs that are reproducible to the bit and hold out no view, as the evaluation's do."""
    return Settings(
        models=models_dir,
        training=TrainingSettings(iterations=25, time_budget_s=None, max_gaussians=300, held_out_every=0),
    )


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return made_data.nerfstudio(tmp_path / "data set", 6, TEST_VIEWS)


def _training_views(folder: Path, target: Path) -> Path:
    """A copy of the data set without its test frames."""
    shutil.copytree(folder, target)
    document = json.loads((target / "transforms.json").read_text())
    document.pop("split")
    document["frames"] = [frame for number, frame in enumerate(document["frames"]) if number not in TEST_VIEWS]
    (target / "transforms.json").write_text(json.dumps(document))
    return target


def _by_worker(upload: Path, work: Path, exact_settings: Settings) -> Path:
    admitted = validate_upload(upload, CaptureSettings())
    job = Job("operation", 1, admitted.folder, work, SceneOptions(), exact_settings)
    for stage, run in STAGES.items():
        result = start_stage(job, stage)
        run(job, result, silent)
        finish_stage(job, stage, result, 1.5)
    return job.result("export") / "artefact"


def _by_evaluation(folder: Path, work: Path, exact_settings: Settings) -> Path:
    trained = train_on_split(read_dataset(folder, exact_settings.capture), exact_settings, work / "capture")
    return _written(trained.scene, work / "artefact")


def _by_library(upload: Path, work: Path, exact_settings: Settings) -> Path:
    capture = capture_folder(upload, work / "capture", exact_settings.capture)
    return _written(build_scene(capture, exact_settings, capture_seconds=2.5).scene, work / "artefact")


def _written(scene: Scene, folder: Path) -> Path:
    write_scene(scene, folder)
    return folder


def _keys(value: Any, path: str = "") -> Iterator[str]:
    if isinstance(value, dict):
        for name, item in value.items():
            yield f"{path}/{name}"
            yield from _keys(item, f"{path}/{name}")


def test_the_same_capture_gives_the_same_manifest_keys_and_arrays(
    folder: Path, tmp_path: Path, exact_settings: Settings
) -> None:
    artefacts = (
        _by_worker(_training_views(folder, tmp_path / "posted"), tmp_path / "job", exact_settings),
        _by_evaluation(folder, tmp_path / "evaluation", exact_settings),
        _by_library(_training_views(folder, tmp_path / "own"), tmp_path / "library", exact_settings),
    )
    manifests = [json.loads((artefact / "scene.json").read_text()) for artefact in artefacts]
    watched = {"/quality/preview_seconds"}  # only a worker's training is watched; it is the same training
    by_worker, *key_lists = [sorted(set(_keys(manifest)) - watched) for manifest in manifests]
    assert key_lists == [by_worker] * 2
    assert {f"/quality/{name}" for name in ("preset", "tradeoffs", "label_source", "stage_seconds/capture")} <= set(
        by_worker
    )
    assert {manifest["quality"]["label_source"] for manifest in manifests} == {"given"}
    assert all(manifest["training"] == manifests[0]["training"] for manifest in manifests)
    first, *rest = [read_scene(artefact) for artefact in artefacts]
    for scene in rest:
        assert [posed.name for posed in scene.cameras] == [posed.name for posed in first.cameras]
        for name, array in vars(scene.gaussians).items():
            np.testing.assert_array_equal(array, getattr(first.gaussians, name), name)


@pytest.mark.parametrize("preset", [None, "draft"])
def test_what_a_scene_records_of_its_making(preset: PresetName | None) -> None:
    trained = TrainedSplats(made_data.scene().gaussians, made_data.scene().head, {"psnr": 20.0}, ("a.jpg",))
    camera = PosedCamera(made_data.CAMERA, np.eye(4), "b.jpg")
    points = np.zeros((0, 3), np.float32)
    report = CaptureReport("images", 4, ("c.jpg",), warnings=("blurred",))
    capture = Capture((View(camera, Path("b.jpg")),), points, points.astype(np.uint8), "METRIC", report)
    plan_facts = SceneFacts(preset=preset, tradeoffs=("fewer views",))
    facts = scene_facts(trained, Labelling(dictionary_of(["mug"]), ()), capture, Settings(), plan_facts)
    quality = facts.with_quality(scene_quality(trained, capture, {"training": 2.0}))
    assert (quality["preset"], quality["tradeoffs"], quality["psnr"]) == (preset, ["fewer views"], 20.0)
    assert (quality["images"], quality["registered"], quality["unregistered"]) == (4, 1, ["c.jpg"])
    assert quality["label_source"] == "detected" and quality["held_out_views"] == ["a.jpg"]
    unnamed = Labelling(dictionary_of([]), ())
    assert scene_facts(trained, unnamed, capture, Settings(), plan_facts).label_source == "none"
    measured = {name: quality[name] for name in ("psnr", "gaussians", "images", "registered", "stage_seconds")}
    assert split_quality(quality) == (facts, {**measured, "mean_reprojection_error_px": 0.0})
    json.dumps(quality, allow_nan=False)
