"""The command as an operator types it: a whole run on a tiny data set, and its refusals before anything is trained."""

from __future__ import annotations

import json
import subprocess
import sys
from importlib.metadata import PackageNotFoundError
from pathlib import Path
from typing import NoReturn

import pytest
from typer.testing import CliRunner, Result

from fastsplat.cli import evaluate
from fastsplat.cli.main import app
from fastsplat.service.application.service import open_service
from fastsplat.service.capture.types import ValidatedUpload
from fastsplat.service.scene.scene_files import read_scene, write_scene
from fastsplat.service.settings import Settings, load_settings
from fastsplat.service.store.records import SceneSummary
from fastsplat.service.store.store import open_store
from fastsplat_contract.errors import (
    FastSplatError,
    InvalidInputError,
    MissingPackageError,
    NotFoundError,
    NotReadyError,
)
from fastsplat_contract.operations import SceneOptions
from tests.evaluation import made_data
from tests.evaluation.test_scene_evaluation import KEYS


@pytest.fixture
def run(models_dir: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("FASTSPLAT_MODELS", str(models_dir))
    monkeypatch.setenv("FASTSPLAT_DATA_DIR", str(tmp_path / "data"))
    monkeypatch.setenv("FASTSPLAT_TRAINING__ITERATIONS", "40")
    monkeypatch.setenv("FASTSPLAT_PERCEPTION__MAX_VIEWS", "2")
    monkeypatch.setenv("FASTSPLAT_PERCEPTION__PROPOSAL_VIEWS", "2")
    load_settings.cache_clear()

    def call(*words: object) -> Result:
        return CliRunner().invoke(app, ["evaluate", *map(str, words)])

    yield call
    load_settings.cache_clear()


def _raised(result: Result) -> FastSplatError:
    assert isinstance(result.exception, FastSplatError), result.output
    return result.exception


def test_a_run_trains_scores_draws_and_its_scene_can_be_scored_again(run, tmp_path: Path) -> None:
    folder = made_data.nerfstudio(tmp_path / "made", 6, (1, 4))
    json_file, pictures, keep = tmp_path / "out/figures.json", tmp_path / "sheets", tmp_path / "scene"
    result = run(
        folder, "--preset", "draft", "--time-budget", 60, "--max-gaussians", 500,
        "--json", json_file, "--pictures", pictures, "--keep", keep,
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    written = json.loads(json_file.read_text())
    assert set(KEYS) <= set(written)
    assert written["things_recall_50"] is None and "nobody looked" in written["reasons"]["things_recall_50"]
    assert set(written["seconds"]) == {"capture", "perception", "training", "export", "scoring"}
    assert written["peak_mb"] > 50 and 0 < written["gaussians"] <= 500 and written["bytes"] > 0
    assert written["settings"]["max_gaussians"] == 500 and written["settings"]["held_out_every"] == 0
    assert written["dataset"]["train_views"] == 4 and len(written["views"]) == 2
    assert 0 <= written["miou"] <= 1 and written["psnr"] > 5
    assert sorted(path.name for path in pictures.iterdir()) == ["images_001.jpg", "images_004.jpg"]
    assert "miou" in result.output and "red mug" in result.output
    again = run(folder, "--scene", keep, "--json", tmp_path / "again.json")
    assert again.exit_code == 0, again.output
    second = json.loads((tmp_path / "again.json").read_text())
    assert second["peak_mb"] is None and "trained" in second["reasons"]["peak_mb"]
    for key in ("miou", "miou_per_class", "ghost_rate", "psnr", "depth_error", "absent_auroc", "intervals", "bytes"):
        assert second[key] == written[key]


def test_a_scene_of_the_data_folder_is_found_by_its_id_once_it_is_ready(run, tmp_path: Path) -> None:
    folder = made_data.nerfstudio(tmp_path / "made", 6, (1, 4))
    scene_id, operation_id = _posted(tmp_path / "data")
    assert isinstance(_raised(run(folder, "--scene", scene_id)), NotReadyError)
    store = open_store(tmp_path / "data")
    claim = store.jobs.claim(operation_id)
    assert claim is not None
    write_scene(made_data.scene(), store.blobs.job(operation_id) / "artefact")
    store.blobs.publish(store.blobs.job(operation_id), scene_id, "v1")
    store.jobs.succeed(claim, SceneSummary("v1", 3, "METRIC", [], [], {}, 0))
    store.close()
    result = run(folder, "--scene", scene_id, "--json", tmp_path / "figures.json")
    assert result.exit_code == 0, result.output
    written = json.loads((tmp_path / "figures.json").read_text())
    assert written["miou"] == 1 == written["localization"] and written["gaussians"] == 3


def _posted(data_dir: Path) -> tuple[str, str]:
    """Scene and operation id of an upload that nobody has looked at."""
    settings = Settings(data_dir=data_dir)
    with open_service(settings, lambda folder, limits, strict: ValidatedUpload(folder, "images", 1)) as service:
        with service.new_upload() as upload:
            upload.write("a.jpg", [b"picture"])
            operation = service.create_scene(upload, "a place", "", SceneOptions())
        return operation.scene_id, operation.id


def test_masks_without_labels_for_training_are_asked_for(run, tmp_path: Path) -> None:
    folder = made_data.three_d_ovs(tmp_path / "bed", 5, ["01"])
    error = _raised(run(folder))
    assert isinstance(error, InvalidInputError) and "--labels detected" in error.hint


def test_detected_labels_leave_the_data_sets_own_maps_alone(run, tmp_path: Path) -> None:
    folder = made_data.nerfstudio(tmp_path / "made", 4, (1,))
    assert "red mug" in _raised(run(folder, "--labels", "detected")).message  # the default detector knows COCO's names
    document = json.loads((folder / "transforms.json").read_text())
    document["labels"] = {"cup": 1, "spoon": 2, "bed": 3}
    (folder / "transforms.json").write_text(json.dumps(document))
    result = run(folder, "--labels", "detected", "--max-gaussians", 200, "--json", tmp_path / "figures.json")
    assert result.exit_code == 0, result.output
    written = json.loads((tmp_path / "figures.json").read_text())
    assert written["miou"] == 0 and written["miou_per_class"] == {"cup": 0, "spoon": 0, "bed": 0}  # balls are no cups


def test_photos_alone_become_a_scene_that_is_validated_without_the_test_views(
    run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The names of the data set, which the default detector does not know, are not asked for."""
    monkeypatch.setenv("FASTSPLAT_PERCEPTION__MAX_VIEWS", "1")
    monkeypatch.setenv("FASTSPLAT_PERCEPTION__PROPOSAL_VIEWS", "0")
    folder = made_data.nerfstudio(tmp_path / "made", 6, (1,))
    keep, json_file = tmp_path / "scene", tmp_path / "figures.json"
    words = ("--split", "validation", "--max-gaussians", 200, "--json", json_file)
    result = run(folder, "--labels", "default", "--keep", keep, *words)
    assert result.exit_code == 0, result.output
    written, scene = json.loads(json_file.read_text()), read_scene(keep)
    assert written["dataset"]["split"] == "validation" and written["dataset"]["test_views"] == 1
    assert written["dataset"]["train_views"] == len(scene.cameras) == 4
    measured = {view["name"] for view in written["views"]}
    assert (
        not (measured | {"images/001.png"}) & {camera.name for camera in scene.cameras}
        and "images/001.png" not in measured
    )
    assert not {entry.label for entry in scene.dictionary.entries} & set(made_data.LABELS)


def test_things_are_discovered_without_any_label(run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = load_settings()
    small = {
        "discovery": settings.discovery.model_copy(update={"min_weight_px": 4.0}),
        "perception": settings.perception.model_copy(update={"min_pixels": 8}),
    }
    monkeypatch.setattr("fastsplat.cli.evaluate.load_settings", lambda: settings.model_copy(update=small))
    folder = made_data.nerfstudio(tmp_path / "made", 6, (1, 4))
    keep, json_file = tmp_path / "scene", tmp_path / "figures.json"
    result = run(folder, "--labels", "discovered", "--max-gaussians", 200, "--keep", keep, "--json", json_file)
    assert result.exit_code == 0, result.output
    scene = read_scene(keep)
    assert scene.things is not None and len(scene.dictionary) == 0
    assert all(thing.name == "" for thing in scene.things.table)
    written = json.loads(json_file.read_text())
    for name in ("things_recall_50", "things_recall_75", "things_precision", "things_ap50", "clicks_miou"):
        assert (written[name] is None and written["reasons"][name]) or 0 <= written[name] <= 1
    assert written["things_recall_50"] is not None or "which things" in written["reasons"]["things_recall_50"]


def test_what_cannot_be_written_or_found_is_said_before_training(run, tmp_path: Path) -> None:
    folder = made_data.nerfstudio(tmp_path / "made")
    (tmp_path / "file").write_text("")
    assert "folder" in _raised(run(folder, "--json", tmp_path)).message
    assert "no folder" in _raised(run(folder, "--pictures", tmp_path / "file")).message
    assert "exists" in _raised(run(folder, "--keep", tmp_path)).message
    assert isinstance(_raised(run(folder, "--scene", "nothing")), NotFoundError)
    assert isinstance(_raised(run(tmp_path / "nowhere")), NotFoundError)
    assert run(folder, "--preset", "luxury").exit_code == 2


def test_a_folder_that_is_not_there_is_refused_before_torch_is_loaded(tmp_path: Path) -> None:
    program = (
        "import sys; from fastsplat.cli.main import app; from fastsplat_contract.errors import NotFoundError\n"
        "try: app(['evaluate', sys.argv[1]], standalone_mode=False)\n"
        "except NotFoundError as error: print(error.field, error.message)\n"
        "print([name for name in ('torch', 'cv2', 'scipy', 'pycolmap', 'onnxruntime') if name in sys.modules])"
    )
    command = [sys.executable, "-c", program, str(tmp_path / "nope")]
    output = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert output.splitlines() == [f"DIR there is no folder {tmp_path / 'nope'}", "[]"]


def test_without_the_package_of_metrics_nothing_is_trained(
    run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing(name: str) -> NoReturn:
        raise PackageNotFoundError(name)

    monkeypatch.setattr(evaluate, "distribution", missing)
    error = _raised(run(made_data.nerfstudio(tmp_path / "made", 3, (1,)), "--keep", tmp_path / "scene"))
    assert isinstance(error, MissingPackageError) and "fastsplat[evaluation]" in error.hint
    assert not (tmp_path / "scene").exists()
