"""Uploads: bounded, safely named, a job or no trace; one request id, one job."""

from __future__ import annotations

import shutil
from dataclasses import asdict
from pathlib import Path

import pytest

from fastsplat.service.application.service import open_service
from fastsplat.service.application.uploading.uploads import SPACE_CHECK_BYTES
from fastsplat.service.capture.captures import ValidatedUpload
from fastsplat.service.common.cancellation import Cancellation, cancellable
from fastsplat.service.settings import Settings
from fastsplat_contract.errors import (
    CancelledError,
    CorruptImageError,
    FastSplatError,
    InvalidInputError,
    LimitExceededError,
    ResourceError,
)
from fastsplat_contract.jobs.operations import SceneOptions
from fastsplat_contract.messages.requests import EstimateJobRequest
from tests.scenes import stand_in_models
from tests.web.photos import write_photos


def left_behind(service, folder: Path) -> list[str]:
    """Files of uploads and jobs, and scenes in the database."""
    files = [path.relative_to(folder).as_posix() for kind in ("uploads", "jobs") for path in (folder / kind).rglob("*")]
    return files + [scene.id for scene in service.list_scenes()[0]]


def test_how_long_photos_take_is_kept_with_their_job_once_the_machine_is_measured(tmp_path):
    models = stand_in_models(tmp_path / "models", "minilm_l6_int8")
    with open_service(Settings(data_dir=tmp_path / "data", models=models)) as service:

        def stored_time(budget_s: float | None = None) -> float | None:
            with service.new_upload() as upload:
                for path in write_photos(tmp_path, 3):
                    upload.write(path.name, [path.read_bytes()])
                operation = service.create_scene(upload, "", "", SceneOptions(preset="draft", time_budget_s=budget_s))
            return service._store.scenes.operation(operation.id).options.get("predicted_s")

        assert stored_time() is None
        estimate = service.estimates.estimate(EstimateJobRequest(photos=3, width=64, height=64, preset="draft"))
        assert stored_time() == estimate.seconds and stored_time(1.0) == pytest.approx(estimate.stages["capture"] + 1)


def test_names_that_no_detector_can_know_are_refused_at_once(service, settings):
    def post(*files: str) -> None:
        with service.new_upload() as upload:
            for name in files:
                upload.write(name, [b"picture"])
            service.create_scene(upload, "", "", SceneOptions(labels=("Cups", "toy bulldozer")))

    with pytest.raises(InvalidInputError, match="cannot know: toy bulldozer") as raised:
        post("a.jpg")
    assert raised.value.field == "labels" and "OPEN_SET_DETECTOR" in raised.value.hint
    assert left_behind(service, settings.data_dir) == []
    post("a.jpg", "labels.json")  # no detector will run
    assert len(service.list_scenes()[0]) == 1


def test_an_archive_is_dropped_once_unpacked(service, settings):
    with service.new_upload() as upload:
        upload.write("all.zip", [b"archive"])
        service.create_scene(upload, "", "", SceneOptions())
    names = [path.name for path in (settings.data_dir / "uploads").rglob("*") if path.is_file()]
    assert names == ["a.jpg"]


def test_whoever_leaves_while_files_are_checked_gets_no_scene(settings):
    leaving = Cancellation()

    def admit(folder, _, strict):
        leaving.cancel()
        return ValidatedUpload(folder, "images", 1)

    with open_service(settings, admit) as service:
        with service.new_upload() as upload, cancellable(leaving):
            upload.write("a.jpg", [b"abc"])
            with pytest.raises(CancelledError):
                service.create_scene(upload, "", "", SceneOptions())
        assert left_behind(service, settings.data_dir) == []


def test_photos_of_one_name_are_all_kept_under_names_of_their_own(service, settings):
    with service.new_upload() as upload:
        upload.write("b/a.jpg", [b"0"])
        for name in ("b", "b/a.jpg/c"):
            with pytest.raises(InvalidInputError, match="two files of this upload"):
                upload.write(name, [b"0"])
        for number, name in enumerate(("b/a (2).jpg", "b/a.jpg", "./b/a.jpg", "b/a (2).jpg"), 1):
            upload.write(name, [str(number).encode()])
        service.create_scene(upload, "", "", SceneOptions())
    files = {path.name: path.read_text() for path in settings.data_dir.glob("uploads/*/*/b/*")}
    assert files == {"a.jpg": "0", "a (2).jpg": "1", "a (3).jpg": "2", "a (4).jpg": "3", "a (2) (2).jpg": "4"}


def test_two_files_of_one_name_are_refused_where_label_maps_mean_one_of_them(service, settings):
    with service.new_upload() as upload:
        for name in ("a.jpg", "labels.json", "a.jpg"):
            upload.write(name, [b"1"])
        with pytest.raises(InvalidInputError, match=r"two files of this upload are called 'a\.jpg'"):
            service.create_scene(upload, "", "", SceneOptions())
    assert left_behind(service, settings.data_dir) == []


def test_bytes_are_counted_over_all_files(service):
    with service.new_upload() as upload:
        upload.write("a", [b"x" * 600])
        with pytest.raises(LimitExceededError) as caught:
            upload.write("b", (b"x" * 100 for _ in range(10**9)))  # stops reading at the limit
        assert "1000" in caught.value.limit and caught.value.hint


def test_files_are_counted(service):
    with service.new_upload() as upload:
        for number in range(5):
            upload.write(f"{number}", [b""])
        with pytest.raises(LimitExceededError, match="5 files"):
            upload.write("6", [b""])


def test_a_refused_upload_leaves_nothing_and_its_request_id_is_free(service, settings):
    with service.new_upload() as upload:
        upload.write("bad.jpg", [b"x"])
        with pytest.raises(CorruptImageError):
            service.create_scene(upload, "", "once", SceneOptions())
    assert left_behind(service, settings.data_dir) == []
    with service.new_upload() as upload:
        upload.write("good.jpg", [b"x"])
        service.create_scene(upload, "", "once", SceneOptions())


def test_an_empty_upload_is_refused(service, settings):
    with service.new_upload() as upload, pytest.raises(InvalidInputError, match="no files"):
        service.create_scene(upload, "", "", SceneOptions())
    assert left_behind(service, settings.data_dir) == []


def test_a_session_ends_with_its_commit(service):
    with service.new_upload() as upload:
        upload.write("a", [b"1"])
        service.create_scene(upload, "", "", SceneOptions())
        with pytest.raises(InvalidInputError):
            upload.write("b", [b"1"])
        with pytest.raises(InvalidInputError):
            service.create_scene(upload, "", "", SceneOptions())
        upload.abort()
    assert len(service.list_scenes()[0]) == 1


@pytest.mark.parametrize(
    "options",
    [
        {"time_budget_s": 0.0},
        {"time_budget_s": float("nan")},
        {"time_budget_s": float("inf")},
        {"time_budget_s": 1e9},
        {"max_gaussians": 0},
        {"max_gaussians": 101},
        {"labels": ("a", "b", "c", "d")},
        {"labels": (" ",)},
        {"labels": ("x" * 500,)},
        {"name": "x" * 500},
        {"name": "a\0b"},
        {"request_id": "with space"},
        {"request_id": "x" * 201},
    ],
    ids=str,
)
def test_senseless_options_are_refused_and_named(service, settings, options):
    said = dict(options)
    name, request_id = said.pop("name", ""), said.pop("request_id", "")
    with service.new_upload() as upload:
        upload.write("a.jpg", [b"x"])
        with pytest.raises(FastSplatError) as caught:
            service.create_scene(upload, name, request_id, SceneOptions(**said))
    assert caught.value.field == next(iter(options))
    assert left_behind(service, settings.data_dir) == []


def test_two_services_share_a_folder(service, another, post):
    first = post("kitchen", "once")
    with another() as second:
        assert asdict(second.get_scene(first.id)) == asdict(first)
        with second.new_upload() as upload:
            upload.write("a.jpg", [b"picture"])
            assert service.create_scene(upload, "kitchen", "once", SceneOptions()).scene_id == first.id
        second.delete_scene(first.id)
    assert service.list_scenes() == ((), "")


def test_an_upload_ends_when_the_disk_becomes_almost_full_meanwhile(service, settings):
    large = settings.model_copy(update={"capture": settings.capture.model_copy(update={"max_upload_bytes": 1 << 30})})
    with open_service(large) as service:
        with service.new_upload() as upload:
            file = upload.begin("a.jpg")
            file.write(b"abc")
            root, usage = str(settings.data_dir), shutil.disk_usage
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(shutil, "disk_usage", lambda path: usage(path)._replace(free=usage(root).total // 1000))
                with pytest.raises(ResourceError) as caught:
                    file.write(bytes(SPACE_CHECK_BYTES))
        assert "MIN_FREE_BYTES" in caught.value.limit
        assert left_behind(service, settings.data_dir) == []
