"""Photos that are withdrawn from a finished scene by a real worker with the real stages: gone for good."""

from __future__ import annotations

import io
import json
import shutil
import subprocess
import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.capture.photos.scene_photos import photo_path, write_photos
from fastsplat.service.capture.settings import PhotoSettings
from fastsplat.service.capture.types import Capture, GivenLabels, View
from fastsplat.service.common.progress import silent
from fastsplat.service.perception.text.open_text_encoder import open_text_encoder
from fastsplat.service.perception.types import Labelling
from fastsplat.service.pipeline import Provenance, scene_quality
from fastsplat.service.scene.label_evidence import UNIT, evidence_of
from fastsplat.service.scene.scene_files import read_scene
from fastsplat.service.scene.types import Scene, Thing, Things
from fastsplat.service.settings import Settings
from fastsplat.service.splat_import.pictures import Painter
from fastsplat.service.splatting.train import train
from fastsplat.service.store.blobs import Blobs
from fastsplat.service.store.file_digests import write_digests
from fastsplat.service.store.photo_repository import record_photos
from fastsplat.workers.claimed_job import ClaimedJob
from fastsplat.workers.drafts import write_made
from fastsplat.workers.job_kinds import KINDS
from fastsplat.workers.supervisor import Supervisor
from fastsplat_contract.camera import PosedCamera
from fastsplat_contract.errors import ConflictError, InvalidInputError, NotFoundError, NotReadyError
from fastsplat_contract.places import Alignment
from fastsplat_contract.poses import Pose, Quaternion, Vector3, look_at
from fastsplat_contract.scenes import Edit
from fastsplat_contract.train_more_messages import TrainMoreIn
from fastsplat_contract.withdrawal_messages import WithdrawPhotosIn
from tests.scenes import add_photos, labelled_scene, store_scene
from tests.splatting.train.conftest import LABELS, MakeWorld
from tests.splatting.train.conftest import make_world as make_world
from tests.workers.real_worker import TRAINING, eventually, over
from tests.workers.real_worker import service as service
from tests.workers.real_worker import start_worker as start_worker

_LETTER = "letter.png"
_CHECKER = np.kron(np.indices((3, 4)).sum(0) % 2, np.ones((16, 16), int))[..., None] * np.array([255, -255, 255])
_CHECKER = np.abs(_CHECKER + np.array([0, 255, 0]) - np.random.default_rng(2).integers(0, 60, (48, 64, 1))).astype(
    np.uint8
)
"""uint8 [48, 64, 3]: green and magenta, which nothing else is, and grain, which makes its file long."""


def _with_letter(capture: Capture, labelling: Labelling, folder: Path) -> tuple[Capture, Labelling]:
    """The capture with a photo from its middle upward, where no other looks, of a checker, and points on that; and with
    the label maps as files."""
    camera = capture.views[0].posed.camera
    posed = PosedCamera(camera, look_at(np.array([0.0, 0.0, 3.0]), np.array([0.3, 0.0, 4.5])), _LETTER)
    folder.mkdir()
    Image.fromarray(_CHECKER).save(folder / _LETTER)
    rows, columns = np.mgrid[2:48:4, 2:64:4]
    rays = camera.rays(columns.ravel() + 0.5, rows.ravel() + 0.5) @ posed.world_from_camera[:3, :3].T
    points = (posed.world_from_camera[:3, 3] + 1.5 * rays).astype(np.float32)
    maps = (*labelling.label_maps, np.zeros((48, 64), np.uint16))
    paths = []
    for number, ids in enumerate(maps):
        paths.append(folder / f"{number}.map.png")
        Image.fromarray(ids.astype(np.uint8)).save(paths[-1])
    more = replace(
        capture,
        views=(*capture.views, View(posed, folder / _LETTER)),
        points=np.concatenate([capture.points, points]),
        point_colors=np.concatenate([capture.point_colors, _CHECKER[rows.ravel(), columns.ravel()]]),
        given_labels=GivenLabels(labelling.dictionary, tuple(paths)),
        report=replace(capture.report, images=len(maps)),
    )
    return more, replace(labelling, label_maps=maps, exact=True)


def _jpeg(pixels: NDArray[np.uint8]) -> bytes:
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, format="JPEG")
    return file.getvalue()


@pytest.fixture
def scene_id(service: SceneService, make_world: MakeWorld, tmp_path: Path, models_dir: Path) -> str:
    """A scene of 200 steps, and its nine photos; a thing of it has the letter as its picture."""
    capture, labelling = _with_letter(*make_world(8), tmp_path / "letter")
    trained = train(capture, labelling, TRAINING.model_copy(update={"iterations": 200}), silent)
    count = len(trained.gaussians)
    encoder = open_text_encoder("minilm_l6_int8", models_dir)
    looks = np.eye(1, 384, dtype=np.float16).tobytes()
    letter = Thing(1, "paper", "detected", 0.9, appearance=looks, picture=_jpeg(_CHECKER))
    owner = np.where(trained.gaussians.means[:, 2] > 2, 1, 2)
    scene = replace(
        labelled_scene(np.zeros((count, 3)), np.ones(count, int), LABELS, encoder=encoder),
        gaussians=trained.gaussians,
        head=trained.head,
        cameras=tuple(view.posed for view in capture.views),
        scale="ARBITRARY",
        quality=scene_quality(trained, labelling, capture, Provenance()),
        things=Things((letter, Thing(2)), evidence_of(np.arange(count), owner, np.full(count, UNIT), count)),
    )
    made = store_scene(service._store, scene)
    folder = service._store.blobs.version(made, "1")
    write_photos(capture, folder, PhotoSettings())
    write_digests(folder)
    with service._store.engine.begin() as connection:
        verdicts = [{"name": name, "placed": True} for name in ("000.png", _LETTER)]
        verdicts[0] |= {"duplicate_of": _LETTER, "defects": ["duplicate", "dark"], "between": []}
        record_photos(connection, made, verdicts)
    return made


def _shown(folder: Path, posed: PosedCamera) -> float:
    """How much of the checker a version's picture from a camera has: the correlation of its green less its red."""
    picture = Painter(read_scene(folder / "artefact").gaussians).picture(posed)[0].astype(np.float64)
    seen, drawn = picture[..., 1] - picture[..., 0], _CHECKER[..., 1] - 127.5
    return 0.0 if seen.std() < 1.0 else float(np.corrcoef(seen.ravel(), drawn.ravel())[0, 1])


def _holding(data: Path, secrets: Sequence[bytes]) -> list[str]:
    """The files below a folder that hold any of these bytes."""
    files = [path for path in data.rglob("*") if path.is_file()]
    return [str(path) for path in files if any(secret in path.read_bytes() for secret in secrets)]


def test_a_letter_is_in_no_file_and_no_picture_any_more(
    service: SceneService, scene_id: str, start_worker: Callable[[], subprocess.Popen[bytes]], tmp_path: Path
) -> None:
    data, store = tmp_path / "data", service._store
    service.versions.edit(scene_id, [Edit("name", things=(1,), name="tax letter")])
    before, old = service.get_scene(scene_id), store.blobs.version(scene_id, "1")
    letter = before.cameras[-1]
    assert letter.name == _LETTER and _shown(old, letter) > 0.5
    assert store.known_names.all(), "the database has a picture of it"
    photo = photo_path(old, 8).read_bytes()
    secrets = (photo[-300:-200], photo[-150:-50], _jpeg(_CHECKER)[-150:-50])
    assert len(_holding(data, secrets[:2])) == 2 and any("sqlite" in name for name in _holding(data, secrets[2:]))

    operation = service.withdrawal.order(scene_id, WithdrawPhotosIn((_LETTER,), "gone"))
    assert operation.kind == "withdraw_photos" and service.get_scene(scene_id).state == "READY"
    with pytest.raises(ConflictError, match="works on this scene"):
        service.training.order(scene_id, TrainMoreIn(steps=10))
    worker = start_worker()
    eventually(lambda: list((data / "jobs").glob("*/checkpoint.*/training.safetensors")))
    worker.kill()
    worker.wait(timeout=60)
    assert service.get_scene(scene_id).version == before.version, "half a withdrawal is none"
    motion = Pose(Vector3(1.0, 2.0, 0.0), Quaternion(0.0, 0.0, 0.0, 1.0))
    service.versions.edit(scene_id, [Edit("align", alignment=Alignment("map", motion))])
    kept = {version.version for version in service.versions.all(scene_id)}
    start_worker()
    done = over(service, operation)
    made = done.withdraw_photos
    assert done.state == "SUCCEEDED" and made is not None, done.error
    assert made.photos == (_LETTER,) and set(made.removed) == kept and made.carried == 1
    assert [text.partition(":")[0] for text in made.lost] == ["name 'tax letter'"]

    after = service.get_scene(scene_id)
    assert [posed.name for posed in after.cameras] == [f"{number:03d}.png" for number in range(8)]
    assert [version.version for version in service.versions.all(scene_id)] == [made.version, after.version]
    assert np.allclose(after.cameras[0].world_from_camera[:2, 3] - before.cameras[0].world_from_camera[:2, 3], (1, 2))
    folder = store.blobs.version(scene_id, made.version)
    assert abs(_shown(folder, letter)) < 0.2 and _shown(folder, before.cameras[0]) < 0.2
    assert after.quality["psnr"] > 15 and after.quality["registered"] == 8 and after.quality["images"] == 8
    assert [entry.label for entry in after.dictionary] == list(LABELS)
    assert [photo.view for photo in service.photos.all(scene_id).photos] == [posed.name for posed in after.cameras]
    with pytest.raises(NotFoundError):
        service._scenes.reading(scene_id, "1", lambda index, name: index)
    (verdict,) = store.photos.of_scene(scene_id)
    assert verdict["name"] == "000.png" and verdict["defects"] == ["dark"] and not verdict["duplicate_of"]
    assert not store.known_names.all()
    eventually(lambda: not list((data / "jobs").iterdir()))
    assert not _holding(data, secrets)
    assert not list((data / "trash").glob("*"))

    again = service.withdrawal.order(scene_id, WithdrawPhotosIn((_LETTER,), "gone"))
    assert again == done, "the same order is the same operation, though the photo is gone"
    with pytest.raises(InvalidInputError, match="has no photo"):
        service.withdrawal.order(scene_id, WithdrawPhotosIn((_LETTER,)))


def _made_anew(job: ClaimedJob, scene: Scene, photos: Path) -> None:
    """The result of the last stage, as a worker leaves it: the scene without its last photo."""
    folder = job.folder / "export"
    left = replace(scene, cameras=scene.cameras[:-1], quality={"stage_seconds": {}})
    folder.mkdir(parents=True)
    write_made(left, folder)
    shutil.copytree(photos, folder / "photos")
    (folder / "photos" / "00002.jpg").unlink()
    (folder / "stage.json").write_text(json.dumps({"seconds": 1.0}))
    write_digests(folder)


def test_a_crash_before_the_last_file_is_gone_leaves_the_new_scene_and_the_work_to_do(
    tmp_path: Path, make_world: MakeWorld, monkeypatch: pytest.MonkeyPatch
) -> None:
    cameras = [view.posed for view in make_world(3)[0].views]
    with open_service(Settings(data_dir=tmp_path / "data")) as service:
        store = service._store
        scene = labelled_scene(np.zeros((5, 3)), np.ones(5, int), ["mug"], cameras=cameras)
        scene_id = store_scene(store, scene)
        add_photos(store, scene_id, [Image.new("RGB", (8, 6), (9 * number, 0, 0)) for number in range(3)])
        operation = service.withdrawal.order(scene_id, WithdrawPhotosIn(("002.png",)))
        store.blobs.trash_version(scene_id, "1", 0.0)  # what an earlier crash has left
        shutil.copytree(tmp_path / "data/trash/scenes" / f"{scene_id}.1.0", store.blobs.version(scene_id, "1"))
        claim = store.jobs.claim(operation.id)
        assert claim is not None
        job = ClaimedJob(store, claim, service._settings.calls)
        _made_anew(job, scene, store.blobs.version(scene_id, "1") / "photos")
        with monkeypatch.context() as crash:
            crash.setattr(Blobs, "erase_versions", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
            with pytest.raises(KeyboardInterrupt):
                job.replace_scene("export")
        assert service.get_scene(scene_id).version == operation.id
        told = service.get_operation(operation.id)
        assert told.state == "RUNNING" and told.withdraw_photos is None, "it is not done as long as a file is there"
        assert store.blobs.fetch_version(scene_id, "1") is not None
        service.cancel_operation(operation.id)  # too late: the scene is another one

        for _ in range(service._settings.jobs.max_starts):  # it is never given up any more
            claim = store.jobs.claim(operation.id)
        assert claim is not None
        kind = KINDS["withdraw_photos"]
        assert Supervisor(store, service._settings, claim, kind, threading.Event()).run().state == "done"
        told = service.get_operation(operation.id)
        assert told.state == "SUCCEEDED" and told.withdraw_photos is not None
        assert told.withdraw_photos.removed == ("1",)
        assert store.blobs.versions().keys() == {(scene_id, operation.id)}
        assert not store.blobs.trashed_scenes() and not store.blobs.half_removed()
        assert [row["name"] for row in store.scenes.scene(scene_id).cameras] == ["000.png", "001.png"]


def test_orders_that_make_no_sense_are_refused(tmp_path: Path, make_world: MakeWorld) -> None:
    cameras = [view.posed for view in make_world(3)[0].views]
    with open_service(Settings(data_dir=tmp_path / "data")) as service:
        scene = labelled_scene(np.zeros((5, 3)), np.ones(5, int), ["mug"], cameras=cameras)
        scene_id = store_scene(service._store, scene)
        with pytest.raises(NotReadyError, match="no photos are kept"):
            service.withdrawal.order(scene_id, WithdrawPhotosIn(("002.png",)))
        add_photos(service._store, scene_id, [Image.new("RGB", (8, 6))] * 3)
        for photos in ((), ("9.png",), ("001.png", "001.png"), ("001.png", "002.png")):
            with pytest.raises(InvalidInputError) as caught:
                service.withdrawal.order(scene_id, WithdrawPhotosIn(photos))
            assert caught.value.field.startswith("photos")
        with pytest.raises(NotFoundError):
            service.in_project("other").withdrawal.order(scene_id, WithdrawPhotosIn(("002.png",)))
        further = service.training.order(scene_id, TrainMoreIn(steps=10))
        with pytest.raises(ConflictError, match=further.id):
            service.withdrawal.order(scene_id, WithdrawPhotosIn(("002.png",)))
        service.cancel_operation(further.id)
        assert service.withdrawal.order(scene_id, WithdrawPhotosIn(("002.png",))).state == "QUEUED"
