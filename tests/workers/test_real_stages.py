"""The whole way with the real rooms: a posed and labelled capture in, a scene that answers out."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from fastsplat.service.application.service import open_service
from fastsplat.service.scene.ply import read_ply
from fastsplat.service.settings import Settings
from fastsplat.service.splatting.settings import TrainingSettings
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.operations import SceneOptions
from fastsplat_contract.queries import PictureRequest, QueryRequest
from tests.small_tabletop import small_tabletop

_VIEWS = 8
_ITERATIONS = 150
_ROOT = Path(__file__).parent.parent.parent


@pytest.fixture
def tabletop(test_data: Path, tmp_path: Path) -> Path:
    """A small copy of the table-top benchmark, with its label maps as the user's own."""
    return small_tabletop(test_data, tmp_path / "tabletop", _VIEWS)


@pytest.fixture
def settings(tmp_path: Path, models_dir: Path) -> Settings:
    """Few and small steps."""
    training = TrainingSettings(iterations=_ITERATIONS, time_budget_s=None, max_gaussians=6000, max_side=120)
    return Settings(data_dir=tmp_path / "data", models=models_dir, training=training)


def _work(settings: Settings) -> subprocess.Popen[bytes]:
    training = settings.training
    environment = {
        **os.environ,
        "FASTSPLAT_DATA_DIR": str(settings.data_dir),
        "FASTSPLAT_MODELS": str(settings.models),
        "FASTSPLAT_TRAINING": training.model_dump_json(include={"iterations", "time_budget_s", "max_side"}),
    }
    command = [sys.executable, "-m", "fastsplat.cli.main", "worker"]
    return subprocess.Popen(command, env=environment, cwd=_ROOT, start_new_session=True)


def test_a_posed_and_labelled_capture_becomes_a_scene_that_answers(tabletop, settings, tmp_path):
    worker = _work(settings)
    try:
        with open_service(settings) as service:
            with service.new_upload() as upload:
                for path in sorted(tabletop.rglob("*")):
                    if path.is_file():
                        with path.open("rb") as file:
                            upload.write(path.relative_to(tabletop).as_posix(), file)
                operation = service.create_scene(upload, "table", "", SceneOptions(max_gaussians=6000))
            deadline = time.monotonic() + 200
            while (now := service.get_operation(operation.id)).state in ("QUEUED", "RUNNING"):
                assert time.monotonic() < deadline, now
                time.sleep(0.2)
            assert now.state == "SUCCEEDED", now.error

            info = service.get_scene(operation.scene_id)
            assert info.state == "READY" and info.scale == "METRIC" and 0 < info.gaussians <= 6000
            assert len(info.cameras) == info.quality["images"] == info.quality["registered"] == _VIEWS
            assert info.quality["unregistered"] == []
            photos = service.list_photo_verdicts(info.id)
            assert photos.assessed and photos.placed_count == photos.photo_count == _VIEWS
            assert [photo.name for photo in photos.photos] == [camera.name for camera in info.cameras]
            assert set(info.quality["stage_seconds"]) == {"capture", "perception", "training", "export"}
            assert info.quality["psnr"] > 12
            rows = {row.label: row for row in info.dictionary}
            assert rows["mug"].gaussian_count > 0 and rows["mug"].views == _VIEWS

            view = info.cameras[0].name
            outputs = frozenset({"mask2d", "mask3d"})
            texts = ("the mug", "swimming pool")
            mug, pool = service.answers.query(QueryRequest(info.id, texts, views=(view,), outputs=outputs))
            assert mug.verdict == "exact" and mug.matches[0].label == "mug" and mug.masks[0].area > 0
            assert pool.verdict != "exact"
            assert service.answers.picture(PictureRequest(info.id, "overlay", "mug", view=view)).startswith(b"\x89PNG")
            (tmp_path / "mug.ply").write_bytes(service.answers.mask_ply(info.id, "mug"))
            assert len(read_ply(service.answers.scene_ply(info.id)[0])) == info.gaussians
            assert len(read_ply(tmp_path / "mug.ply")) == rows["mug"].gaussian_count

            # The photos stay with the scene, each that of its camera, and are covered by its digests.
            assert [photo.view for photo in service.photos.all(info.id).photos] == [one.name for one in info.cameras]
            sources = {posed.name: next(tabletop.glob(f"images/{Path(posed.name).stem}.*")) for posed in info.cameras}
            for posed in info.cameras:
                path, version = service.photos.path(info.id, posed.name)
                assert min(sources, key=lambda name: _difference(path, sources[name])) == posed.name
                assert _difference(path, sources[posed.name]) < 8
            digests = path.parent.parent / "files.sha256"
            assert f"photos/{path.name}" in digests.read_text() and version == info.version
            best = service.photos.best_views(info.id, text="mug")
            assert best.views and all(one.photo and one.share > 0 for one in best.views)
    finally:
        worker.terminate()
        assert worker.wait(timeout=60) == 0


def test_a_training_shows_itself_and_is_kept_as_it_is_when_it_is_ended_early(tabletop, settings):
    endless = settings.training.model_copy(update={"iterations": 1_000_000})
    settings = settings.model_copy(update={"training": endless})
    worker = _work(settings)
    try:
        with open_service(settings) as service:
            with service.new_upload() as upload:
                for path in sorted(tabletop.rglob("*")):
                    if path.is_file():
                        with path.open("rb") as file:
                            upload.write(path.relative_to(tabletop).as_posix(), file)
                operation = service.create_scene(upload, "table", "", SceneOptions(max_gaussians=6000))
            deadline = time.monotonic() + 200
            while (now := service.get_operation(operation.id)).preview is None or now.preview.step < 100:
                assert time.monotonic() < deadline and not now.done, now
                time.sleep(0.2)
            picture = cv2.imdecode(
                np.frombuffer(service.jobs.preview(operation.id).picture, np.uint8), cv2.IMREAD_COLOR
            )
            assert picture.shape == (now.preview.height, now.preview.width, 3) == (90, 120, 3)
            placed = service.jobs.placed_cameras(operation.id)
            assert placed.info.complete and placed.info.placed == len(placed.cameras) == _VIEWS
            assert 0 < len(placed.points) // 12 == len(placed.colors) // 3 <= 5_000
            assert now.seconds_left is not None and now.seconds_left > 60  # a million steps are not done soon

            service.jobs.finish(operation.id)
            while (now := service.get_operation(operation.id)).state in ("QUEUED", "RUNNING"):
                assert time.monotonic() < deadline, now
                time.sleep(0.2)
            assert now.state == "SUCCEEDED", now.error
            quality = service.get_scene(operation.scene_id).quality
            assert quality["stopped_early"] and 250 <= quality["iterations"] < 1_000_000
            assert 0 < quality["stopped_at_share"] < 1 and quality["preview_seconds"] < quality["train_seconds"]
            assert quality["psnr"] > 12
    finally:
        worker.terminate()
        assert worker.wait(timeout=60) == 0


def _difference(one: Path, other: Path) -> float:
    """Of two pictures of one size, in steps of 8 bits."""
    first, second = (np.asarray(Image.open(path).convert("RGB"), dtype=np.float64) for path in (one, other))
    return float(np.abs(first - second).mean())


def test_what_the_capture_room_refuses_leaves_nothing(settings):
    with open_service(settings) as service:
        with service.new_upload() as upload:
            upload.write("photo.jpg", [b"this is a text"])
            upload.write(".admitted/manifest.json", [b"{}"])
            with pytest.raises(InvalidInputError):
                service.create_scene(upload, "", "", SceneOptions())
        assert service.list_scenes() == ((), "")
    assert list((settings.data_dir / "uploads").iterdir()) == []


def test_photos_of_two_places_end_as_a_failure_that_says_what_to_do(settings, test_data):
    photos = (test_data / "plush" / "images" / "20240212_003919.jpg", test_data / "kitchen" / "images" / "00.jpg")
    worker = _work(settings)
    try:
        with open_service(settings) as service:
            with service.new_upload() as upload:
                for path in photos:
                    with path.open("rb") as file:
                        upload.write(path.name, file)
                operation = service.create_scene(upload, "two places", "", SceneOptions())
            deadline = time.monotonic() + 100
            while (now := service.get_operation(operation.id)).state in ("QUEUED", "RUNNING"):
                assert time.monotonic() < deadline, now
                time.sleep(0.2)
            assert now.state == "FAILED" and now.error is not None
            assert (now.error.kind, now.error.stage) == ("FAILED_PRECONDITION", "capture")
            assert now.error.reason == "RECONSTRUCTION_FAILED" and now.error.details["hint"]
            assert service.get_scene(operation.scene_id).state == "FAILED"
    finally:
        worker.terminate()
        assert worker.wait(timeout=60) == 0
    left = [path for kind in ("jobs", "scenes") for path in (settings.data_dir / kind).rglob("*") if path.is_file()]
    assert left == []
