"""Questions to a real small scene with the real text encoder."""

from __future__ import annotations

import io
import shutil
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from PIL import Image

from fastsplat.service.application.service import open_service
from fastsplat.service.query.objects.object_index import KEPT_MAP_BYTES
from fastsplat.service.scene.formats.ply import read_ply
from fastsplat.service.settings import Settings
from fastsplat_contract.errors import (
    InvalidInputError,
    NotFoundError,
    NotReadyError,
    SceneFileError,
)
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from fastsplat_contract.messages.queries import QueryRequest
from fastsplat_contract.photos.pictures import PictureRequest

BEHIND = PosedCamera(Camera(40, 30, 40.0, 40.0, 20.0, 15.0), np.diag([-1.0, 1.0, -1.0, 1.0]))


@pytest.fixture
def settings(settings: Settings, models_dir) -> Settings:
    return settings.model_copy(update={"models": models_dir})


@pytest.fixture
def ready(post, finish):
    info = post()
    finish(info)
    return info


def pixels(png: bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(png)))


def test_a_ready_scene_shows_what_it_holds(service, ready):
    info = service.get_scene(ready.id)
    assert info.state == "READY" and info.quality == {"psnr": 31.0} and info.scale == "METRIC"
    assert [(row.label, row.aliases, row.gaussian_count) for row in info.dictionary] == [
        ("mug", ("cup",), 1),
        ("banana", ("cup",), 1),
    ]
    assert info.cameras[0].name == "front.jpg" and np.array_equal(info.cameras[0].world_from_camera, np.eye(4))
    assert service.list_scenes().scenes[0].label_count == 2


def test_texts_are_answered_in_order_with_masks_in_views_and_free_cameras(service, ready):
    request = QueryRequest(
        ready.id, ("mug", "bananas"), (BEHIND,), ("front.jpg",), outputs=frozenset({"mask2d", "mask3d"})
    )
    mug, banana = service.answers.query(request).answers
    assert [answer.outcome for answer in (mug, banana)] == ["here", "here"]
    assert [answer.matches[0].label for answer in (mug, banana)] == ["mug", "banana"]
    assert (mug.mask3d, banana.mask3d) == (b"\x80", b"\x40")
    for answer, side in ((mug, slice(0, 20)), (banana, slice(20, 40))):
        behind, front = answer.masks
        assert (behind.view, behind.camera_index, behind.area) == ("", 0, 0)
        mask = front.array()
        assert mask.shape == (30, 40) and front.view == "front.jpg"
        assert 0 < mask.sum() == mask[:, side].sum() == front.area


def test_nothing_is_computed_that_was_not_asked_for(service, ready):
    (answer,) = service.answers.query(QueryRequest(ready.id, ("mug",), views=("front.jpg",))).answers
    assert answer.masks == () and answer.mask3d is None and answer.objects is None


def test_all_ready_scenes_are_asked_newest_first(service, ready, post, finish):
    newer, unfinished = post("newer"), post("unfinished")
    finish(newer)
    answers = service.answers.query(QueryRequest("", ("mug", "banana"), outputs=frozenset({"mask3d"}))).answers
    assert [answer.scene_id for answer in answers] == [newer.id, newer.id, ready.id, ready.id]
    assert [answer.text for answer in answers] == ["mug", "banana"] * 2
    assert answers[0].mask3d == b"\x80" and unfinished.id not in {answer.scene_id for answer in answers}
    with pytest.raises(InvalidInputError, match="mask2d"):
        service.answers.query(QueryRequest("", ("mug",), outputs=frozenset({"mask2d"})))


def test_plys_hold_the_scene_and_the_answer(service, ready, tmp_path):
    whole = read_ply(service.answers.scene_ply(ready.id)[0])
    parts = []
    for text in ("banana", "quarterly tax return"):
        request = QueryRequest(ready.id, (text,), outputs=frozenset({"mask3d"}), mask3d_encoding="ply")
        (tmp_path / "mask.ply").write_bytes(service.answers.query(request).answers[0].mask3d)
        parts.append(read_ply(tmp_path / "mask.ply"))
    assert len(whole) == 2 and np.array_equal(parts[0].means, whole.means[1:]) and len(parts[1]) == 0


def test_an_unfinished_scene_says_what_to_wait_for(service, post):
    info = post()
    calls = [
        lambda: service.answers.query(QueryRequest(info.id, ("mug",))).answers,
        lambda: service.answers.picture(PictureRequest(info.id, "rgb", view="front.jpg")),
        lambda: service.answers.scene_ply(info.id),
    ]
    for call in calls:
        with pytest.raises(NotReadyError, match="still being made") as caught:
            call()
        assert info.operation_id in caught.value.hint
    service.cancel_operation(info.operation_id)
    with pytest.raises(NotReadyError, match="was cancelled"):
        calls[0]()


def test_threads_share_one_open_scene(service, ready, monkeypatch):
    opened = []
    real = service._context.scenes._load
    monkeypatch.setattr(service._context.scenes, "_load", lambda *key: opened.append(key) or real(*key))
    request = QueryRequest(ready.id, ("mug",), views=("front.jpg",), outputs=frozenset({"mask2d"}))
    with ThreadPoolExecutor(8) as pool:
        answers = list(pool.map(lambda _: service.answers.query(request).answers, range(16)))
    assert len(opened) == 1 and all(answer == answers[0] for answer in answers)


def test_only_so_many_bytes_of_scenes_stay_open(post, finish, settings):
    scenes = [post(str(number)) for number in range(3)]
    for info in scenes:
        finish(info)
    folder = settings.data_dir / "scenes" / scenes[0].id / "v1" / "artefact"
    weight = 2 * sum(path.stat().st_size for path in folder.iterdir()) + KEPT_MAP_BYTES
    calls = settings.calls.model_copy(update={"scene_memory_bytes": int(2.5 * weight)})
    with open_service(settings.model_copy(update={"calls": calls})) as bounded:
        assert len(bounded.answers.query(QueryRequest("", ("mug",))).answers) == 3
        assert bounded._context.scenes.count() == 2
        assert 0 < bounded._context.scenes._open.bytes <= 2.5 * weight


def test_a_version_without_its_artefact_folder_is_damaged_and_not_deleted(service, settings, post, finish) -> None:
    info = post()
    finish(info)
    shutil.rmtree(settings.data_dir / "scenes" / info.id / "v1" / "artefact")
    with pytest.raises(SceneFileError, match="artefact") as caught:
        service.answers.query(QueryRequest(info.id, ("mug",)))
    assert info.id in caught.value.message and "v1" in caught.value.message
    shutil.rmtree(settings.data_dir / "scenes" / info.id)
    with pytest.raises(NotFoundError):
        service.answers.query(QueryRequest(info.id, ("mug",)))
