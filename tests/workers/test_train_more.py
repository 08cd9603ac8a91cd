"""Jobs that train a finished scene further: durable, with checkpoints, and put into what the scene is when they end."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fastsplat.service.application.service import open_service
from fastsplat.service.settings import QuotaSettings, Settings
from fastsplat.service.store.version_repository import NewVersion
from fastsplat_contract.errors import (
    ConflictError,
    InvalidInputError,
    LimitExceededError,
    NotFoundError,
    NotReadyError,
    QuotaError,
)
from fastsplat_contract.operations import Operation
from fastsplat_contract.poses import Pose, Quaternion, Vector3
from fastsplat_contract.scenes import Edit
from fastsplat_contract.train_more_messages import TrainMoreIn
from tests.scenes import add_photos, labelled_scene, store_scene
from tests.workers.deployment import Deployment


@pytest.fixture
def training(tmp_path: Path) -> Iterator[Deployment]:
    deployment = Deployment(tmp_path, "")  # what is PostgreSQL's own, the tests of other jobs say
    yield deployment
    deployment.close()


def _scene(deployment: Deployment) -> str:
    scene_id = deployment.wait_over(deployment.post()).scene_id
    add_photos(deployment.service._store, scene_id, [Image.new("RGB", (8, 6))])
    return scene_id


def _more(deployment: Deployment, scene_id: str, request_id: str = "") -> Operation:
    return deployment.service.training.order(scene_id, TrainMoreIn(steps=10, request_id=request_id))


def _edited_elsewhere(deployment: Deployment, scene_id: str, name: str) -> None:
    store = deployment.service._store
    parent = store.scenes.scene(scene_id)
    shutil.copytree(store.blobs.version(scene_id, parent.version), store.blobs.version(scene_id, name))
    store.versions.publish(NewVersion(scene_id, name, parent.version, "", "", 5, parent.dictionary, [], 0))


def test_it_survives_a_killed_worker_and_what_was_edited_meanwhile_stays(training: Deployment) -> None:
    worker = training.start_worker()
    scene_id = _scene(training)
    (trained,) = training.service.versions.all(scene_id)
    (training.settings.data_dir / "orders.txt").write_text("training:kill_worker_until 1\nmerging:sleep 2\n")
    operation = _more(training, scene_id, "once")
    assert operation.kind == "train_more" and operation.scene_id == scene_id
    training.wait_for(lambda: worker.poll() is not None)
    assert training.service.get_scene(scene_id).state == "READY"
    training.start_worker()
    training.wait_in("merging", operation)
    _edited_elsewhere(training, scene_id, "edited")
    done = training.wait_over(operation)
    assert done.state == "SUCCEEDED" and [stage.stage for stage in done.stages] == ["training", "merging"]
    made = done.train_more
    assert made is not None and made.trained_from == trained.version and made.current
    assert made.steps >= 2  # the second attempt went on from the checkpoint of the first
    parents = {version.version: version.parent for version in training.service.versions.all(scene_id)}
    assert parents == {trained.version: "", "edited": trained.version, made.version: "edited"}
    assert [edit.action for edit in training.service.versions.all(scene_id)[-1].edits] == ["train_more"]
    assert training.service.get_scene(scene_id).quality["psnr"] == 21.0
    assert _more(training, scene_id, "once").id == operation.id
    training.service.versions.restore(scene_id, trained.version)
    assert training.service.get_scene(scene_id).quality["psnr"] == 30.0  # each version says how good it is
    training.service.versions.restore(scene_id, made.version)
    assert training.service.get_scene(scene_id).quality["psnr"] == 21.0
    training.wait_for(lambda: not training.left_over())


def test_what_contradicts_an_edit_stands_beside_it(training: Deployment) -> None:
    training.start_worker()
    scene_id = _scene(training)
    (trained,) = training.service.versions.all(scene_id)
    (training.settings.data_dir / "beside").touch()
    _edited_elsewhere(training, scene_id, "moved")
    training.service.versions.restore(scene_id, trained.version)
    operation = _more(training, scene_id)
    training.service.versions.restore(scene_id, "moved")
    done = training.wait_over(operation)
    assert done.train_more is not None and not done.train_more.current
    assert training.service.get_scene(scene_id).version == "moved"
    made = next(v for v in training.service.versions.all(scene_id) if v.version == done.train_more.version)
    assert made.parent == trained.version and not made.current
    assert training.service.versions.restore(scene_id, made.version).current
    assert training.service.get_scene(scene_id).quality["psnr"] == 21.0


def test_orders_that_make_no_sense_are_refused(tmp_path: Path) -> None:
    with open_service(Settings(data_dir=tmp_path / "data", quotas=QuotaSettings(queued_jobs=1))) as service:
        scene = labelled_scene(np.random.default_rng(0).normal(size=(30, 3)), np.ones(30, int), ["mug"])
        scene_id = store_scene(service._store, scene)
        with pytest.raises(NotReadyError, match="no photos are kept"):
            service.training.order(scene_id, TrainMoreIn(steps=10))
        add_photos(service._store, scene_id, [Image.new("RGB", (8, 6))])
        for order, field in (
            (TrainMoreIn(seconds=5.0, steps=10), "steps"),
            (TrainMoreIn(steps=10**9), "steps"),
            (TrainMoreIn(seconds=1e9), "seconds"),
            (TrainMoreIn(steps=10, request_id="no spaces, please"), "request_id"),
        ):
            with pytest.raises((InvalidInputError, LimitExceededError)) as caught:
                service.training.order(scene_id, order)
            assert caught.value.field == field
        with pytest.raises(NotFoundError):
            service.training.order("0" * 32, TrainMoreIn(steps=10))
        with pytest.raises(NotFoundError):
            service.in_project("other").training.order(scene_id, TrainMoreIn(steps=10))
        first = service.training.order(scene_id, TrainMoreIn(steps=10, request_id="one"))
        assert service.training.order(scene_id, TrainMoreIn(steps=10, request_id="one")) == first
        with pytest.raises(ConflictError):
            service.training.order(scene_id, TrainMoreIn(steps=20, request_id="one"))
        with pytest.raises(QuotaError):
            service.training.order(scene_id, TrainMoreIn(steps=10))


def test_a_version_in_which_things_were_moved_is_not_trained_further(tmp_path: Path, models_dir: Path) -> None:
    with open_service(Settings(data_dir=tmp_path / "data", models=models_dir)) as service:
        from fastsplat.service.perception.text.open_text_encoder import open_text_encoder

        encoder = open_text_encoder("minilm_l6_int8", models_dir)
        means = np.random.default_rng(0).normal(0, 0.05, size=(60, 3))
        scene_id = store_scene(service._store, labelled_scene(means, np.ones(60, int), ["mug"], encoder=encoder))
        add_photos(service._store, scene_id, [Image.new("RGB", (8, 6))])
        named = service.versions.edit(scene_id, [Edit("name", label="mug", name="cup")])
        motion = Pose(Vector3(0.5, 0.0, 0.0), Quaternion(0.0, 0.0, 0.0, 1.0))
        moved = service.versions.edit(scene_id, [Edit("move", label="cup", transform=motion)])
        service.versions.edit(scene_id, [Edit("name", label="cup", name="beaker")], looked_at=moved.version)
        with pytest.raises(NotReadyError, match="shows what its photos do not \\(move\\)") as caught:
            service.training.order(scene_id, TrainMoreIn(steps=10))
        assert f"Restore version {named.version}," in caught.value.hint and moved.version != named.version
        service.versions.restore(scene_id, named.version)
        assert service.training.order(scene_id, TrainMoreIn(steps=10)).state == "QUEUED"
