"""The capture that is left when photos are withdrawn: a function of the other photos alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from PIL import Image

from fastsplat.service.capture.formats.capture_files import load_capture, save_capture
from fastsplat.service.capture.photos.scene_photos import photo_folder, write_photos
from fastsplat.service.capture.settings import CaptureSettings, PhotoSettings
from fastsplat.service.capture.types import Capture, GivenLabels
from fastsplat.service.common.progress import silent
from fastsplat.service.common.similarity import Similarity
from fastsplat.service.perception.labelling import label_capture
from fastsplat.service.perception.settings import PerceptionSettings
from fastsplat.service.perception.types import Labelling
from fastsplat.service.scene.scaling import Scaling
from fastsplat.service.scene.types import TAKEN_AT, Scene
from fastsplat.service.withdrawal import capture_without, with_joined_cameras
from fastsplat.service.withdrawal_checks import check_retrainable
from fastsplat_contract.errors import InvalidInputError, NotReadyError
from tests.scenes import labelled_scene
from tests.splatting.train.conftest import LABELS, MakeWorld
from tests.splatting.train.conftest import make_world as make_world

_GONE = "002.png"


def _with_maps(capture: Capture, labelling: Labelling, folder: Path) -> Capture:
    """The capture with label maps that came with it."""
    folder.mkdir()
    paths = []
    for view, ids in zip(capture.views, labelling.label_maps, strict=True):
        paths.append(folder / view.posed.name)
        Image.fromarray(ids.astype(np.uint8)).save(paths[-1])
    return replace(capture, given_labels=GivenLabels(labelling.dictionary, tuple(paths)))


def _textured(capture: Capture) -> Capture:
    """The same cameras, before a ground of blotches."""
    ground = cv2.GaussianBlur(np.random.default_rng(1).uniform(0, 255, (256, 256, 3)).astype(np.float32), (5, 5), 0)
    for view in capture.views:
        camera, pose = view.posed.camera, view.posed.world_from_camera
        rows, columns = np.mgrid[: camera.height, : camera.width]
        rays = camera.rays(columns.ravel() + 0.5, rows.ravel() + 0.5) @ pose[:3, :3].T
        places = pose[:2, 3] - rays[:, :2] * (pose[2, 3] / np.minimum(rays[:, 2:], -1e-6))
        at = (48 * places).reshape(camera.height, camera.width, 2).astype(np.float32) % 255
        seen = cv2.remap(ground, at[..., 0], at[..., 1], cv2.INTER_LINEAR)
        Image.fromarray((2.5 * (seen - 128) + 128).clip(0, 255).astype(np.uint8)).save(view.image_path)
    return capture


def _kept(capture: Capture, folder: Path, **quality: Any) -> Scene:
    """The scene of a capture, whose photos are kept in a version's folder."""
    folder.mkdir()
    write_photos(capture, folder, PhotoSettings())
    scene = labelled_scene(np.zeros((3, 3)), np.ones(3, int), LABELS)
    names = [view.posed.name for view in capture.views]
    said = {"held_out_views": names[::4], "label_source": "given", "source": "images", "images": 15, **quality}
    cameras = tuple(view.posed for view in capture.views)
    return replace(scene, cameras=cameras, scale="ARBITRARY", quality=said)


def _files(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_the_rest_is_the_same_whatever_a_withdrawn_photo_showed(make_world: MakeWorld, tmp_path: Path) -> None:
    capture, labelling = make_world(14, width=256, height=192)
    capture = _with_maps(_textured(capture), labelling, tmp_path / "maps")
    assert capture.given_labels is not None
    gone = next(view for view in capture.views if view.posed.name == _GONE)
    made = []
    for number, points in enumerate((capture.points, capture.points + 0.5)):
        if number:  # the photo, its labels, and what points and colors once took from it
            Image.fromarray(np.random.default_rng(3).integers(0, 255, (192, 256, 3), np.uint8)).save(gone.image_path)
            Image.new("L", (256, 192), 3).save(tmp_path / "maps" / _GONE)
        folder, out = tmp_path / f"version{number}", tmp_path / f"out{number}"
        scene = _kept(replace(capture, points=points), folder, warnings=[f"{_GONE} is blurred.", "Dark."])
        before = _files(folder)
        out.mkdir()
        left = capture_without(scene, folder, out, (_GONE,), CaptureSettings(), silent)
        save_capture(left, out)
        made.append(_files(out))
        assert _files(folder) == before, "a version never changes"
    assert made[0] == made[1] and not any("work" in name for name in made[0])
    assert b"002.png" not in made[0]["capture.json"]

    again = load_capture(tmp_path / "out0")
    names = [view.posed.name for view in capture.views if view.posed.name != _GONE]
    assert [view.posed.name for view in again.views] == names and again.test_names == tuple(names[:1] + names[3::4])
    assert again.report.images == 14 and again.report.warnings == ("Dark.",) and again.scale == "ARBITRARY"
    poses = {view.posed.name: view.posed.world_from_camera for view in capture.views}
    assert all(np.array_equal(view.posed.world_from_camera, poses[view.posed.name]) for view in again.views)
    assert len(again.points) > 500 and np.median(np.abs(again.points[:, 2])) < 0.01  # on the ground
    labels = label_capture(again, PerceptionSettings(), tmp_path, (), silent)
    maps = {view.posed.name: ids for view, ids in zip(capture.views, labelling.label_maps, strict=True)}
    assert [entry.label for entry in labels.dictionary.entries] == list(LABELS)
    assert all(np.array_equal(ids, maps[name]) for ids, name in zip(labels.label_maps, names, strict=True))


def test_masks_and_times_go_with_their_photos(make_world: MakeWorld, tmp_path: Path) -> None:
    capture, _ = make_world(5)
    mask = np.full((48, 64), 255, np.uint8)
    mask[:, :20] = 0
    Image.fromarray(mask).save(tmp_path / "mask.png")
    views = (*capture.views[:3], replace(capture.views[3], valid_path=tmp_path / "mask.png"), capture.views[4])
    times = {"001.png": 5.0, "003.png": 7.0}
    quality = {"label_source": "none", TAKEN_AT: times, "held_out_views": []}
    scene = _kept(replace(capture, views=views), tmp_path / "version", **quality)
    (tmp_path / "out").mkdir()
    withdrawn = ("000.png", "001.png")
    left = capture_without(scene, tmp_path / "version", tmp_path / "out", withdrawn, CaptureSettings(), silent)
    assert [view.taken_at for view in left.views] == [None, 7.0, None]
    assert [view.valid_path is not None for view in left.views] == [False, True, False]
    path = left.views[1].valid_path
    assert path is not None and np.array_equal(np.asarray(Image.open(path)), mask)
    assert left.given_labels is None and not left.test_names


def test_a_photo_that_has_joined_is_withdrawn_as_any_other(make_world: MakeWorld, tmp_path: Path) -> None:
    capture, labelling = make_world(6)
    capture = _with_maps(capture, labelling, tmp_path / "maps")
    trained = _kept(replace(capture, views=capture.views[:4], given_labels=None), tmp_path / "trained")
    twice = Similarity(2.0, np.eye(3), np.zeros(3))
    scaling = Scaling(2.0, 2.0, 2.0, ())
    whole = _kept(capture, tmp_path / "current", images=6, held_out_views=["000.png"])
    current = replace(whole, scaling=scaling, cameras=tuple(map(twice.camera, whole.cameras)))
    scene = with_joined_cameras(trained, current)
    for posed, view in zip(scene.cameras, capture.views, strict=True):
        np.testing.assert_allclose(posed.world_from_camera, view.posed.world_from_camera, atol=1e-12)
    assert scene.cameras[:4] == trained.cameras
    (tmp_path / "out").mkdir()
    left = capture_without(scene, tmp_path / "current", tmp_path / "out", ("004.png",), CaptureSettings(), silent)
    assert [view.posed.name for view in left.views] == [f"{number:03d}.png" for number in (0, 1, 2, 3, 5)]
    assert left.report.images == 5 and left.test_names == ("000.png",)


def test_what_cannot_be_made_anew_is_refused(make_world: MakeWorld, tmp_path: Path) -> None:
    capture, labelling = make_world(4)
    scene = _kept(_with_maps(capture, labelling, tmp_path / "maps"), tmp_path / "version")
    (tmp_path / "out").mkdir()
    for photos, field in (((), "photos"), (("000.png", "x.png"), "photos[1]"), (("000.png",) * 2, "photos")):
        with pytest.raises(InvalidInputError) as caught:
            capture_without(scene, tmp_path / "version", tmp_path / "out", photos, CaptureSettings(), silent)
        assert caught.value.field == field
        (tmp_path / "out" / "work").rename(tmp_path / f"work{field}{len(photos)}")
        photo_folder(tmp_path / "out").rmdir()
    names = [posed.name for posed in scene.cameras]
    with pytest.raises(InvalidInputError, match="1 of 4 photos would be left"):
        capture_without(scene, tmp_path / "version", tmp_path / "out", names[:3], CaptureSettings(), silent)
    check_retrainable(scene.quality, tmp_path / "version")
    for path in photo_folder(tmp_path / "version").glob("labels.json"):
        path.unlink()
    with pytest.raises(NotReadyError, match="label maps"):
        check_retrainable(scene.quality, tmp_path / "version")
    check_retrainable({"label_source": "detected"}, tmp_path / "version")
    with pytest.raises(NotReadyError, match="came as a file"):
        check_retrainable({"splat": "room.ply"}, tmp_path / "version")
    with pytest.raises(NotReadyError, match="no photos"):
        check_retrainable({}, tmp_path / "maps")
