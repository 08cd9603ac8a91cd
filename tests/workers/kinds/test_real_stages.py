"""The whole way with the real rooms: a posed and labelled capture in, a scene that answers out."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.scene.formats.ply import read_ply
from fastsplat.service.settings import Settings
from fastsplat.service.splatting.training_settings import TrainingSettings
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.jobs.operations import SceneOptions
from fastsplat_contract.messages.queries import QueryRequest
from fastsplat_contract.photos.pictures import PictureRequest
from tests.small_tabletop import small_tabletop
from tests.trained_scenes import trained_tabletop
from tests.waiting import wait_for
from tests.workers.deployment import post_folder, real_worker, wait_over

_VIEWS = 8


@pytest.fixture(scope="module")
def settings(tmp_path_factory: pytest.TempPathFactory, models_dir: Path) -> Settings:
    """Small steps without end."""
    training = TrainingSettings(iterations=1_000_000, time_budget_s=None, max_gaussians=6000, max_side=120)
    return Settings(data_dir=tmp_path_factory.mktemp("place") / "data", models=models_dir, training=training)


@pytest.fixture(scope="module")
def service(settings: Settings) -> Iterator[SceneService]:
    """A service with a worker, which lives as long as the tests of this file."""
    training = settings.training.model_dump_json(include={"iterations", "time_budget_s", "max_side"})
    with open_service(settings) as opened, real_worker(settings, TRAINING=training):
        yield opened


def test_a_posed_and_labelled_capture_becomes_a_scene_that_answers(test_data, models_dir, tmp_path):
    folder = trained_tabletop(test_data, models_dir)
    tabletop = folder / "table top"
    shutil.copytree(folder / "scene", tmp_path / "data")
    with open_service(Settings(data_dir=tmp_path / "data", models=models_dir)) as service:
        (info,) = service.list_scenes().scenes
        info = service.get_scene(info.id)
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
        mug, pool = service.answers.query(QueryRequest(info.id, texts, views=(view,), outputs=outputs)).answers
        assert mug.outcome == "here" and mug.matches[0].label == "mug" and mug.masks[0].area > 0
        assert pool.outcome != "here"
        assert service.answers.picture(PictureRequest(info.id, "overlay", "mug", view=view)).startswith(b"\x89PNG")
        request = QueryRequest(info.id, texts[:1], outputs=outputs - {"mask2d"}, mask3d_encoding="ply")
        (tmp_path / "mug.ply").write_bytes(service.answers.query(request).answers[0].mask3d or b"")
        assert len(read_ply(service.answers.scene_ply(info.id)[0])) == info.gaussians
        assert len(read_ply(tmp_path / "mug.ply")) == rows["mug"].gaussian_count

        # The photos stay with the scene, each that of its camera, and are covered by its digests.
        assert [photo.view for photo in service.photos.all(info.id).photos] == [posed.name for posed in info.cameras]
        sources = {posed.name: next(tabletop.glob(f"images/{Path(posed.name).stem}.*")) for posed in info.cameras}
        for posed in info.cameras:
            path, version = service.photos.path(info.id, posed.name)
            assert min(sources, key=lambda name: _difference(path, sources[name])) == posed.name
            assert _difference(path, sources[posed.name]) < 8
        digests = path.parent.parent / "files.sha256"
        assert f"photos/{path.name}" in digests.read_text() and version == info.version
        best = service.photos.best_views(info.id, text="mug")
        assert best.views and all(view.photo and view.share > 0 for view in best.views)


def test_a_training_shows_itself_and_is_kept_as_it_is_when_it_is_ended_early(test_data, service, tmp_path):
    upload = small_tabletop(test_data, tmp_path / "tabletop", _VIEWS)
    operation = post_folder(service, upload, SceneOptions(max_gaussians=6000), "table")
    wait_for(
        lambda: (picture := service.get_operation(operation.id).preview) is not None and picture.step >= 100, 200.0
    )
    now = service.get_operation(operation.id)
    picture = cv2.imdecode(np.frombuffer(service.jobs.preview(operation.id).picture, np.uint8), cv2.IMREAD_COLOR)
    assert picture.shape == (now.preview.height, now.preview.width, 3) == (90, 120, 3)
    placed = service.jobs.placed_cameras(operation.id)
    assert placed.info.complete and placed.info.placed == len(placed.cameras) == _VIEWS
    assert 0 < len(placed.points) // 12 == len(placed.colors) // 3 <= 5_000
    assert now.seconds_left is not None and now.seconds_left > 60  # a million steps are not done soon

    service.jobs.finish(operation.id)
    assert (over := wait_over(service, operation)).state == "SUCCEEDED", over.error
    quality = service.get_scene(operation.scene_id).quality
    assert quality["stopped_early"] and 250 <= quality["iterations"] < 1_000_000
    assert 0 < quality["stopped_at_share"] < 1 and quality["preview_seconds"] < quality["train_seconds"]
    assert quality["psnr"] > 12


def _difference(left: Path, right: Path) -> float:
    """Of two pictures of one size, in steps of 8 bits."""
    first, second = (np.asarray(Image.open(path).convert("RGB"), dtype=np.float64) for path in (left, right))
    return float(np.abs(first - second).mean())


def test_what_the_capture_room_refuses_leaves_nothing(tmp_path, models_dir):
    settings = Settings(data_dir=tmp_path / "data", models=models_dir)
    with open_service(settings) as service:
        with service.new_upload() as upload:
            upload.write("photo.jpg", [b"this is a text"])
            upload.write(".validated/manifest.json", [b"{}"])
            with pytest.raises(InvalidInputError):
                service.create_scene(upload, "", "", SceneOptions())
        assert service.list_scenes() == ((), "")
    assert list((settings.data_dir / "uploads").iterdir()) == []


def test_photos_of_two_places_end_as_a_failure_that_says_what_to_do(service, settings, test_data, tmp_path):
    for path in (test_data / "plush/images/20240212_003919.jpg", test_data / "kitchen/images/00.jpg"):
        (tmp_path / path.name).write_bytes(path.read_bytes())
    operation = post_folder(service, tmp_path, SceneOptions(), "two places")
    record = service._store.scenes.operation(operation.id)
    now = wait_over(service, operation)
    assert now.state == "FAILED" and now.error is not None
    assert (now.error.kind, now.error.stage) == ("FAILED_PRECONDITION", "capture")
    assert now.error.reason == "RECONSTRUCTION_FAILED" and now.error.details["hint"]
    assert service.get_scene(operation.scene_id).state == "FAILED"
    folders = (service._store.blobs.job(record.run_id), settings.data_dir / "scenes" / operation.scene_id)
    wait_for(lambda: not any(folder.exists() for folder in folders))
