"""A finished scene trained further by a real worker with the real stages: killed on the way, and to no avail."""

from __future__ import annotations

import json
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
import safetensors
from PIL import Image

from fastsplat.service import joined_things
from fastsplat.service.application.service import SceneService
from fastsplat.service.capture.photos.scene_photos import (
    observed_photo_path,
    photo_folder,
    photo_path,
    write_observed_photos,
    write_photos,
)
from fastsplat.service.capture.settings import PhotoSettings
from fastsplat.service.capture.types import Capture, View
from fastsplat.service.common.dictionary import dictionary_of
from fastsplat.service.common.progress import silent
from fastsplat.service.instances.scene_things import regions_of_label_map
from fastsplat.service.instances.settings import DiscoverySettings
from fastsplat.service.joined_photos import joined_name
from fastsplat.service.perception.text.open_text_encoder import open_text_encoder
from fastsplat.service.perception.types import Labelling, Regions, TextEncoder
from fastsplat.service.pipeline import Provenance, scene_quality
from fastsplat.service.scene.label_evidence import UNIT, evidence_of
from fastsplat.service.scene.scene_files import read_scene
from fastsplat.service.scene.things import thing_rows
from fastsplat.service.scene.types import Scene, Thing, Things
from fastsplat.service.settings import Settings
from fastsplat.service.splatting.checkpoint import read_checkpoint, write_checkpoint
from fastsplat.service.splatting.train import train
from fastsplat.service.store.file_digests import write_digests
from fastsplat.service.train_more import capture_of
from fastsplat.workers.protocol import Job
from fastsplat.workers.train_more_stages import STAGES
from fastsplat_contract.errors import InvalidInputError, NotFoundError
from fastsplat_contract.json_codec import to_plain
from fastsplat_contract.localize_messages import PhotoDifference
from fastsplat_contract.observation_messages import Observation, ObservedPhoto
from fastsplat_contract.operations import SceneOptions
from fastsplat_contract.thing_prompts import PixelBox
from fastsplat_contract.train_more_messages import TrainMoreIn
from fastsplat_contract.withdrawal_messages import WithdrawPhotosIn
from tests.scenes import labelled_scene, store_scene
from tests.splatting.train.conftest import MakeWorld
from tests.splatting.train.conftest import make_world as make_world
from tests.waiting import wait_for
from tests.workers.real_worker import STEPS, TRAINING, eventually, over
from tests.workers.real_worker import service as service
from tests.workers.real_worker import start_worker as start_worker

_LABELS = ("floor", "ball", "block")
_OBSERVED, _SEEN_AT = "e7", datetime(2026, 3, 2, 18, tzinfo=UTC)
_BLOCK = np.array([0.4, -0.1, 0.25])
_CHECKPOINTS = "*/checkpoint.*/training.safetensors"
_MARK_S = 1_000.0
"""Seconds that no run of this test takes, written into a checkpoint."""


@pytest.fixture
def scene_id(service: SceneService, make_world: MakeWorld) -> str:
    """A scene of 100 steps with a thing for each third of its Gaussians, and its eight photos."""
    capture, labelling = make_world(8)
    return _stored(service, capture, labelling)


def _stored(
    service: SceneService,
    capture: Capture,
    labelling: Labelling,
    observed: Sequence[View] = (),
    changed: Mapping[int, PixelBox] | None = None,
    encoder: TextEncoder | None = None,
    source: str = "given",
) -> str:
    """A scene of a capture, with an observation of some more views, some of which, by their numbers, show a change;
    where its labels come from models, a person has named all but the block, which has no name."""
    trained = train(capture, labelling, TRAINING.model_copy(update={"iterations": 100}), silent)
    count = len(trained.gaussians)
    table = tuple(Thing(i, name, "detected", 0.9) for i, name in enumerate(_LABELS, start=1))
    owner = 1 + np.arange(count) % 3
    if source == "detected":
        table = (Thing(1, "Anna's floor", "person", 1.0), Thing(2))
        owner = np.where(np.linalg.norm(trained.gaussians.means - _BLOCK, axis=1) < 0.4, 2, 1)
    things = Things(table, evidence_of(np.arange(count), owner, np.full(count, UNIT), count))
    scene = replace(
        labelled_scene(np.zeros((count, 3)), np.ones(count, int), _LABELS, encoder=encoder),
        gaussians=trained.gaussians,
        head=trained.head,
        cameras=tuple(view.posed for view in capture.views),
        scale="ARBITRARY",
        quality={**scene_quality(trained, labelling, capture, Provenance()), "label_source": source},
        things=things,
        observations=(_observation(observed, changed or {}),) if observed else (),
    )
    made = store_scene(service._store, scene)
    folder = service._store.blobs.version(made, "1")
    write_photos(capture, folder, PhotoSettings())
    (photo_folder(folder) / "labels.json").write_text("[]")
    write_observed_photos([_pixels(view) for view in observed], folder, _OBSERVED, PhotoSettings())
    write_digests(folder)
    return made


def _observation(views: Sequence[View], changed: Mapping[int, PixelBox]) -> Observation:
    differences = {number: (PhotoDifference("missing", box, 0.9),) for number, box in changed.items()}
    photos = [
        ObservedPhoto(f"{_OBSERVED}/{number}", view.posed, differences.get(number, ()))
        for number, view in enumerate(views)
    ]
    return Observation("", _OBSERVED, _SEEN_AT, "given", tuple(photos), (), (), (), False, "")


def _pixels(view: View) -> np.ndarray:
    with Image.open(view.image_path) as image:
        return np.asarray(image.convert("RGB"))


def _read(service: SceneService, scene_id: str, version: str) -> Scene:
    return read_scene(service._store.blobs.version(scene_id, version) / "artefact")


def test_a_killed_worker_costs_no_step_and_the_scene_becomes_better(
    service: SceneService, scene_id: str, start_worker: Callable[[], subprocess.Popen[bytes]], tmp_path: Path
) -> None:
    before = service.get_scene(scene_id)
    operation = service.training.order(scene_id, TrainMoreIn(steps=STEPS))
    worker = start_worker()
    jobs = tmp_path / "data" / "jobs"
    eventually(lambda: list(jobs.glob(_CHECKPOINTS)))
    worker.kill()
    worker.wait(timeout=60)
    time.sleep(0.5)  # its trainer is killed at that moment, but may be writing
    assert service.get_scene(scene_id).version == before.version, "half a training is no version"

    # What the second worker goes on from says so: seconds that nobody has trained.
    (path,) = jobs.glob(_CHECKPOINTS)
    with safetensors.safe_open(path, "pt") as file:
        fingerprint = file.metadata()["fingerprint"]
    checkpoint = read_checkpoint(path.parent, fingerprint)
    assert checkpoint is not None and 0 < checkpoint.iteration < STEPS
    write_checkpoint(replace(checkpoint, elapsed_s=_MARK_S), path.parent, fingerprint)
    start_worker()
    done = over(service, operation)
    assert done.state == "SUCCEEDED", done.error
    made = done.train_more
    assert made is not None and made.current and made.steps == STEPS and made.trained_from == before.version
    assert made.seconds > _MARK_S
    assert made.psnr is not None and made.psnr_before is not None and made.psnr > made.psnr_before + 0.3
    scene = service.get_scene(scene_id)
    assert scene.version == made.version and scene.state == "READY"
    assert scene.quality["psnr"] == pytest.approx(made.psnr) and scene.gaussians == made.gaussians
    old, new = _read(service, scene_id, before.version), _read(service, scene_id, made.version)
    assert old.things is not None and new.things is not None and new.things.table == old.things.table
    assert len(thing_rows(new.things)) == len(new.gaussians) == made.gaussians
    assert [photo.view for photo in service.photos.all(scene_id).photos] == [view.name for view in old.cameras]

    # Trained on other pictures than it is judged by, it gets worse, so that everything stays as it is.
    folder = service._store.blobs.version(scene_id, made.version)
    for photo in photo_folder(folder).glob("*.jpg"):
        if new.cameras[int(photo.stem)].name not in new.quality["held_out_views"]:
            with Image.open(photo) as image:
                size = image.size
            photo.unlink()  # one file with that of the version before
            Image.new("RGB", size, (250, 40, 250)).save(photo)
    write_digests(folder)
    failed = over(service, service.training.order(scene_id, TrainMoreIn(steps=60)))
    assert failed.state == "FAILED" and failed.error is not None and failed.error.reason == "TRAINING_DIVERGED"
    assert "stays as it is" in failed.error.message and failed.train_more is None
    after = service.get_scene(scene_id)
    assert (after.version, after.state, after.gaussians) == (made.version, "READY", made.gaussians)
    assert after.quality == scene.quality
    assert {version.version for version in service.versions.all(scene_id)} == {before.version, made.version}
    wait_for(lambda: not list(jobs.iterdir()))  # a job is over before its folder is gone


def test_photos_join_a_scene_after_a_killed_worker_are_undone_and_all_else_stays(
    service: SceneService,
    make_world: MakeWorld,
    start_worker: Callable[[], subprocess.Popen[bytes]],
    tmp_path: Path,
    models_dir: Path,
) -> None:
    capture, labelling = make_world(10)
    encoder = open_text_encoder("minilm_l6_int8", models_dir)
    views, maps = capture.views, labelling.label_maps
    of_scene, camera = replace(capture, views=views[:7]), views[9].posed.camera
    changed = {1: PixelBox(0.0, 0.0, float(camera.width), float(camera.height)), 2: PixelBox(20.0, 20.0, 29.0, 29.0)}
    scene_id = _stored(service, of_scene, replace(labelling, label_maps=maps[:7]), views[7:], changed, encoder)
    before, old = service.get_scene(scene_id), _read(service, scene_id, "1")
    for observations, field, error in (
        (("e9",), "observations[0]", NotFoundError),
        ((_OBSERVED, _OBSERVED), "observations[1]", InvalidInputError),
    ):
        with pytest.raises(error) as caught:
            service.training.order(scene_id, TrainMoreIn(steps=60, observations=observations))
        assert caught.value.field == field

    operation = service.training.order(scene_id, TrainMoreIn(steps=STEPS, observations=(_OBSERVED,)))
    worker = start_worker()
    jobs = tmp_path / "data" / "jobs"
    eventually(lambda: list(jobs.glob(_CHECKPOINTS)))
    worker.kill()
    worker.wait(timeout=60)
    assert to_plain(service.get_scene(scene_id)) == to_plain(before), "half a training is no version"
    start_worker()
    done = over(service, operation)
    assert done.state == "SUCCEEDED", done.error
    made = done.train_more
    assert made is not None and made.current and made.steps == STEPS
    names = [joined_name(_OBSERVED, number) for number in (0, 2)]
    assert list(made.joined) == names
    assert made.left_out == (f"{_OBSERVED}/1: most of it shows changes (missing)",)

    new = _read(service, scene_id, made.version)
    count = len(old.gaussians)
    assert made.unchanged is not None and made.gaussians >= count
    same = [np.array_equal(new.gaussians.means[row], old.gaussians.means[row]) for row in range(count)]
    assert sum(same) >= made.unchanged
    assert new.things is not None and old.things is not None and new.things.table == old.things.table
    assert np.array_equal(thing_rows(new.things)[:count], thing_rows(old.things))
    assert new.quality["registered"] == 9 and new.quality["taken_at"] == dict.fromkeys(names, _SEEN_AT.timestamp())
    shown = service.get_scene(scene_id)
    assert [posed.name for posed in shown.cameras] == [*(view.posed.name for view in views[:7]), *names]
    np.testing.assert_allclose(shown.cameras[-1].world_from_camera, views[9].posed.world_from_camera, atol=1e-9)
    assert "joined_cameras" not in shown.quality
    folder = service._store.blobs.version(scene_id, made.version)
    assert photo_path(folder, 8).read_bytes() == observed_photo_path(folder, _OBSERVED, 2).read_bytes()
    assert names[1] in [photo.view for photo in service.photos.all(scene_id).photos]
    with pytest.raises(InvalidInputError, match="twice"):
        service.training.order(scene_id, TrainMoreIn(steps=60, observations=(_OBSERVED,)))

    # What has joined is trained on from now on as any other photo, and can be withdrawn.
    (tmp_path / "masks").mkdir()
    again = capture_of(new, folder, tmp_path / "masks")
    assert [view.posed.name for view in again.views[7:]] == names and again.test_names
    # But nothing is trained on where a photo shows a change.
    seen, changed_there = (np.asarray(Image.open(view.valid_path)) > 0 for view in again.views[7:] if view.valid_path)
    box = slice(20, 29), slice(20, 29)
    assert seen[box].all() and not changed_there[box].any() and changed_there.sum() > seen.sum() / 2
    service.withdrawal._check(scene_id, WithdrawPhotosIn((names[0],)))
    service.versions.undo(scene_id)
    assert to_plain(service.get_scene(scene_id)) == to_plain(before)


def test_models_look_at_photos_that_join_and_what_they_see_counts(
    service: SceneService, make_world: MakeWorld, tmp_path: Path, models_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    capture, labelling = make_world(10)
    views, maps = capture.views, labelling.label_maps
    of_scene, encoder = replace(capture, views=views[:7]), open_text_encoder("minilm_l6_int8", models_dir)
    first = replace(labelling, label_maps=maps[:7])
    scene_id = _stored(service, of_scene, first, views[7:], None, encoder, "detected")
    folder = service._store.blobs.version(scene_id, "1")
    asked: list[tuple[int, tuple[str, ...]]] = []

    def look(capture: Capture, perception: object, models: Path, names: tuple[str, ...], *_: object, **__: object):
        asked.append((len(capture.views), names))
        blocks = tuple((label_map == 3).astype(np.uint16) for label_map in maps[7:])
        regions = tuple(Regions(block, (((1, 0.95),),)) for block in blocks)
        seen = tuple(regions_of_label_map(label_map).masks() for label_map in maps[7:])
        return Labelling(dictionary_of(["crate"]), blocks, False, regions, seen)

    monkeypatch.setattr(joined_things, "label_capture", look)
    discovery = DiscoverySettings(min_weight_px=5)
    settings = Settings(data_dir=tmp_path / "data", models=models_dir, training=TRAINING, discovery=discovery)
    order = {"observations": [_OBSERVED], "steps": 30, "version": "1"}
    base = (folder, "1")
    job = Job("job", 1, folder, tmp_path / "job", SceneOptions(), settings, order=order, version="1", base=base)
    for stage in ("training", "merging"):
        job.result(stage).mkdir(parents=True)
        STAGES[stage](job, job.result(stage), silent)
    assert asked == [(3, ())]
    old, new = _read(service, scene_id, "1"), read_scene(job.result("merging") / "artefact")
    assert old.things is not None and new.things is not None
    floor, crate = new.things.table
    assert (floor.id, floor.name, floor.source) == (1, "Anna's floor", "person")
    assert (crate.id, crate.name, crate.source) == (2, "crate", "detected")
    assert new.dictionary.entries[-1].label == "crate"
    unchanged = json.loads((job.result("merging") / "summary.json").read_text())["result"]["unchanged"]
    count = len(old.gaussians)
    same = [np.array_equal(new.gaussians.means[row], old.gaussians.means[row]) for row in range(count)]
    assert sum(same) >= unchanged
