"""Pixels that are withheld enter nothing, of every kind of upload: captures that differ only there are the same."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from fastsplat.service.capture import build
from fastsplat.service.capture.build import build_capture
from fastsplat.service.capture.capture_settings import CaptureSettings, PhotoSettings
from fastsplat.service.capture.captures import Capture
from fastsplat.service.capture.formats.depth_maps import load_depth
from fastsplat.service.capture.formats.image_io import load_rgb
from fastsplat.service.capture.formats.upload_manifest import read_manifest
from fastsplat.service.capture.photos.camera_model import CameraModel, compute_undistortion
from fastsplat.service.capture.photos.lens_faces import FACES
from fastsplat.service.capture.photos.panorama import full_frame, panorama_faces, wrapped
from fastsplat.service.capture.photos.scene_photos import photo_path, write_photos
from fastsplat.service.capture.photos.video import middle_per_interval
from fastsplat.service.capture.photos.withholding import BLANK, WithheldPixels, Withholding
from fastsplat.service.capture.sfm.sfm_images import SfmImage, upright_photos
from fastsplat.service.capture.untrusted.image_decoder import ImageDecoder
from fastsplat.service.capture.untrusted.sandbox import Task, run_sandboxed
from fastsplat.service.capture.uploads.upload_validation import validate_upload
from fastsplat.service.capture.views.view_writer import DEPTHS, IMAGES, MASKS, SourceImage, write_view
from fastsplat.service.common.dictionary import Dictionary
from fastsplat.service.common.progress import silent
from fastsplat.service.perception.results import Labelling
from fastsplat.service.splatting.training.train import train
from fastsplat.service.splatting.training_settings import TrainingSettings
from fastsplat_contract.geometry.camera import Camera
from fastsplat_contract.jobs.operations import Privacy
from tests.capture import made_room
from tests.capture.phone_recordings import Frame, polycam
from tests.capture.upload_files import encoded, video_file
from tests.small_tabletop import small_tabletop

Mask = NDArray[np.bool_]
Paint = Callable[[NDArray[np.uint8], int], NDArray[np.uint8]]  # stands in for a picture's pixels, by its number

_SIZE = (120, 90)
_VIEWS = 6
_WALKING = (1, 3, 4)  # the views that show the figure


def _figure(view: int) -> Mask:
    """Where a view shows a figure, from view to view elsewhere."""
    mask = np.zeros(_SIZE[::-1], np.bool_)
    if view in _WALKING:
        mask[20:70, 15 * view : 15 * view + 14] = True
    return mask


def _upload(source: Path, folder: Path, paint: Paint) -> Path:
    """Posed photos of the table-top, in some of which a figure of this paint stands."""
    path = small_tabletop(source.parent, folder, _VIEWS) / "transforms.json"
    document = json.loads(path.read_text())
    for number, frame in enumerate(document["frames"]):
        frame.pop("mask_path")
        pixels = np.asarray(Image.open(folder / frame["file_path"]))
        Image.fromarray(_painted(pixels, _figure(number), paint, number)).save(folder / frame["file_path"])
    path.write_text(json.dumps(document))
    return folder


def _red(pixels: NDArray[np.uint8], number: int) -> NDArray[np.uint8]:
    return np.broadcast_to(np.array([250, 10, 10], np.uint8), pixels.shape)


def _noise(pixels: NDArray[np.uint8], number: int) -> NDArray[np.uint8]:
    return np.random.default_rng(number).integers(0, 256, pixels.shape, dtype=np.uint8)


def _painted(pixels: NDArray[np.uint8], mask: Mask, paint: Paint, number: int) -> NDArray[np.uint8]:
    return np.where(mask[..., None], paint(pixels, number), pixels)


def _capture(test_data: Path, folder: Path, paint: Paint, privacy: Privacy | None):
    _upload(test_data / "tabletop", folder / "upload", paint)
    return _built(folder, CaptureSettings(), map(_figure, range(_VIEWS)), privacy)


def _files(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def _splat(capture: Capture) -> bytes:
    settings = TrainingSettings(iterations=40, time_budget_s=None, max_gaussians=2_000, max_side=60, held_out_every=0)
    trained = train(capture, Labelling(Dictionary(()), ()), settings, silent)
    stream = io.BytesIO()
    np.savez(stream, **vars(trained.gaussians))
    return stream.getvalue()


def test_photos_and_the_whole_say_what_is_withheld(test_data: Path, tmp_path: Path) -> None:
    report = _capture(test_data, tmp_path, _red, "people").report
    expected = [round(float(_figure(view).mean()), 4) for view in range(_VIEWS)]
    assert [photo.withheld for photo in report.photos] == expected and max(expected) > 0.05
    assert report.withheld is not None and report.withheld.privacy == "people"
    assert report.withheld.photos == len(_WALKING)
    assert report.withheld.share == pytest.approx(np.mean([_figure(view).mean() for view in range(_VIEWS)]))


def test_what_is_only_left_out_trains_nothing_but_stays_in_the_photo(test_data: Path, tmp_path: Path) -> None:
    red = _capture(test_data, tmp_path / "red", _red, None)
    noise = _capture(test_data, tmp_path / "noise", _noise, None)
    view = red.views[_WALKING[0]]
    assert np.array_equal(load_rgb(view.image_path)[_figure(_WALKING[0])][0], [250, 10, 10])
    assert red.views[0].valid_path is None and view.valid_path is not None
    valid = load_rgb(view.valid_path)[..., 0] > 0
    assert not valid[_figure(_WALKING[0])].any() and 0.5 < valid.mean() < 1
    assert _splat(red) != _splat(noise)  # by the pixels that structural similarity and smaller sizes mix in
    difference = [np.abs(np.load(io.BytesIO(_splat(capture)))["means"]).mean() for capture in (red, noise)]
    assert difference[0] == pytest.approx(difference[1], rel=0.02)


@pytest.mark.parametrize("shrink", [0.25, 1.0, 2.0])
def test_depths_under_a_mask_change_nothing(tmp_path: Path, shrink: float) -> None:
    width, height = 64, 48
    small = Camera(
        round(width * shrink), round(height * shrink), 50.0 * shrink, 50.0 * shrink, 32.0 * shrink, 24.0 * shrink
    )
    mask = np.ones((height, width), bool)
    mask[11:30, 21:41] = False
    rng = np.random.default_rng(0)
    stored = []
    for attempt in range(2):
        folder = tmp_path / str(attempt)
        for name in (IMAGES, MASKS, DEPTHS):
            (folder / name).mkdir(parents=True)
        depth = np.full((small.height, small.width), 2.0, np.float32)
        y, x = np.mgrid[: small.height, : small.width]
        inside = (x + 1 > 21 * shrink) & (x < 41 * shrink) & (y + 1 > 11 * shrink) & (y < 30 * shrink)
        depth[inside] = rng.uniform(0.5, 1.5, int(inside.sum()))
        model = CameraModel("PINHOLE", width, height, (50.0, 50.0, 32.0, 24.0))
        undistortion = compute_undistortion(model, 1000, field="a")
        pixels = np.zeros((height, width, 3), np.uint8)
        written = write_view(
            SourceImage("a", pixels, undistortion, np.eye(4), mask=mask, depth=(depth, small)), 0, folder
        )
        assert written is not None and written[0].depth is not None
        stored.append(load_depth(written[0].depth))
        assert not stored[-1][inside].any() and stored[-1][0, 0] == pytest.approx(2.0)
    np.testing.assert_array_equal(*stored)


def _withholding(masks: Iterator[Mask], privacy: Privacy | None = "people") -> Withholding:
    """By a detector that says of each picture in turn where somebody is."""
    return Withholding(lambda pixels: next(masks), privacy)


def _built(
    folder: Path, settings: CaptureSettings, masks: Iterator[Mask], privacy: Privacy | None = "people"
) -> Capture:
    upload = validate_upload(folder / "upload", settings)
    return build_capture(upload.folder, folder / "capture", settings, silent, None, _withholding(masks, privacy))


# A video


_FRAME = (240, 180)
_FRAMES, _USED = 18, 6


def _somebody(frame: int) -> Mask:
    mask = np.zeros(_FRAME[::-1], np.bool_)
    mask[50:130, 10 * frame : 10 * frame + 34] = True
    return mask


def _video(folder: Path, paint: Paint) -> None:
    """A walk through the made room past somebody, losslessly."""
    (folder / "upload").mkdir(parents=True)
    width, height = _FRAME
    x, y = np.meshgrid(np.arange(width) + 0.5 - width / 2, np.arange(height) + 0.5 - height / 2)
    rays = np.stack([x / 180, y / 180, np.ones_like(x)], axis=-1)
    frames = []
    for number in range(_FRAMES):
        place = made_room.pose((-1.5, -0.9 + 0.08 * number, 1.3 + 0.1 * np.sin(number)), 12 - number)
        frames.append(_painted(made_room.photo(place, rays), _somebody(number), paint, number))
    video_file(folder / "upload/walk.avi", frames, "FFV1")


def test_frames_of_a_video_withhold(tmp_path: Path) -> None:
    settings = CaptureSettings(sfm_threads=2, sfm_features=400, video_frames=_USED)
    chosen = sorted(middle_per_interval(_FRAMES, _USED))
    for name, paint in (("red", _red), ("noise", _noise)):
        _video(tmp_path / name, paint)
        capture = _built(tmp_path / name, settings, map(_somebody, chosen))
        assert [view.posed.name for view in capture.views] == [f"frame_{number:06d}.png" for number in chosen]
    assert (tmp_path / "red/upload/walk.avi").read_bytes() != (tmp_path / "noise/upload/walk.avi").read_bytes()
    assert _files(tmp_path / "red/capture") == _files(tmp_path / "noise/capture")


# 360° panoramas


_PLACES = (made_room.pose((-0.6, 0.3, 1.4), 20), made_room.pose((0.5, -0.5, 1.5), 110))
_WIDTH = 512


def _beside() -> Mask:
    """Somebody in a panorama, 44 to 46 degrees right of its middle: the front and the right face show them."""
    mask = np.zeros((_WIDTH // 2, _WIDTH), np.bool_)
    columns = ((np.arange(_WIDTH) + 0.5) / _WIDTH - 0.5) * 360
    mask[110:150, (columns > 44) & (columns < 46)] = True
    return mask


def _faces(folder: Path, paint: Paint, settings: CaptureSettings) -> list[SfmImage]:
    """The faces of two panoramas of which a detector finds somebody in the front faces alone."""
    (folder / "upload").mkdir(parents=True)
    for number, pose in enumerate(_PLACES):
        pixels = _painted(made_room.photo(pose, made_room.panorama_rays(_WIDTH)), _beside(), paint, number)
        Image.fromarray(pixels).save(folder / f"upload/{number}.png")
    manifest, files = read_manifest(validate_upload(folder / "upload", settings).folder)
    (folder / "images").mkdir(), (folder / "decoding").mkdir()
    frame = full_frame("x", _WIDTH, _WIDTH // 2)
    picture = wrapped(255 * _beside()[..., None].repeat(3, axis=2).astype(np.uint8), frame)

    def masks() -> Iterator[Mask]:
        for _ in _PLACES:
            for face in panorama_faces(frame, (_WIDTH, _WIDTH // 2), settings.panorama_face_side):
                mask = face.undistortion.apply(picture)[..., 0] > 0
                yield cv2.dilate(mask.astype(np.uint8), np.ones((9, 9))) > 0 if face.name == "front" else mask & False

    held = WithheldPixels(_withholding(masks()), folder / "images/masks")
    with ImageDecoder(folder / "decoding", (files, folder / "images"), settings) as decoder:
        return list(upright_photos(manifest, files, folder / "images", settings, decoder, held, {}))


def test_what_one_face_of_a_panorama_withholds_no_other_shows(tmp_path: Path) -> None:
    settings = CaptureSettings(lens="panorama", panorama_face_side=128)
    red, noise = (_faces(tmp_path / name, paint, settings) for name, paint in (("red", _red), ("noise", _noise)))
    assert _files(tmp_path / "red/images") == _files(tmp_path / "noise/images")
    for first, second in zip(red, noise, strict=True):
        assert first.name == second.name
        for field in ("detail", "contrast", "thumbnail"):
            np.testing.assert_array_equal(getattr(first.quality, field), getattr(second.quality, field))
    blank = {face: (load_rgb(tmp_path / f"red/images/{face}/00000.png") == BLANK).all(axis=2).sum() for face in FACES}
    assert blank["front"] > 100 and blank["right"] > 100 and not blank["back"] and not blank["up"]


# Poses, depth maps and label maps


def _with_maps(source: Path, folder: Path, seed: int) -> None:
    """Depth and label maps beside the photos of `_upload`, of which those of the figure are of a draw."""
    rng = np.random.default_rng(seed)
    path = folder / "transforms.json"
    document = json.loads(path.read_text())
    document["labels"] = {"table": 1, "mug": 2, "person": 7}
    entries = json.loads((source / "transforms.json").read_text())["frames"]
    entries = entries[:: len(entries) // len(document["frames"])]
    (folder / "maps").mkdir()
    for number, frame in enumerate(document["frames"]):
        figure = _figure(number)
        labels = np.where(figure, rng.choice([0, 1, 2, 7], figure.shape), 1).astype(np.uint8)
        small = figure.reshape(45, 2, 60, 2).any(axis=(1, 3))
        with Image.open(source / entries[number]["depth_path"]) as image:
            true = np.asarray(image)[4::8, 4::8] // 10
        depth = np.where(small, rng.integers(400, 3_000, small.shape), true).astype(np.uint16)
        for key, name, pixels in (("mask_path", "labels", labels), ("depth_file_path", "depth", depth)):
            frame[key] = f"maps/{name}{number}.png"
            Image.fromarray(pixels).save(folder / frame[key])
    path.write_text(json.dumps(document))


def test_posed_photos_with_depths_and_labels_withhold_from_everything(test_data: Path, tmp_path: Path) -> None:
    splats = []
    for seed, (name, paint) in enumerate((("red", _red), ("noise", _noise))):
        folder = _upload(test_data / "tabletop", tmp_path / name / "upload", paint)
        _with_maps(test_data / "tabletop", folder, seed)
        capture = _built(tmp_path / name, CaptureSettings(), map(_figure, range(6)))
        assert all(view.depth is not None for view in capture.views) and capture.given_labels is not None
        splats.append(_splat(capture))
        (tmp_path / name / "version").mkdir()
        write_photos(capture, tmp_path / name / "version", PhotoSettings())
    assert _files(tmp_path / "red/upload") != _files(tmp_path / "noise/upload")
    for stage in ("capture", "version"):
        assert _files(tmp_path / "red" / stage) == _files(tmp_path / "noise" / stage)
    assert splats[0] == splats[1]
    photo = load_rgb(photo_path(tmp_path / "red/version", _WALKING[0]))
    assert np.abs(photo[_figure(_WALKING[0])].astype(int) - BLANK).mean() < 8  # JPEG
    maps = tmp_path / "red/capture/labels"
    stored = [np.asarray(Image.open(path)) for path in sorted(maps.iterdir())]
    assert all(not ids[_figure(view)].any() and ids.any() for view, ids in enumerate(stored))


# A phone's recording


def _standing(number: int) -> Mask:
    mask = np.zeros((180, 240), np.bool_)
    mask[40:130, 30 * number : 30 * number + 36] = True
    return mask


def _recording(root: Path, paint: Paint) -> dict[str, bytes]:
    """Five tracked photos of the table-top with a sensor's depth."""
    document = json.loads((root / "transforms.json").read_text())
    frames = []
    for number, entry in enumerate(document["frames"][:15:3]):
        pixels = np.asarray(Image.open(root / entry["file_path"]).resize((240, 180), Image.Resampling.BOX))
        with Image.open(root / entry["depth_path"]) as image:
            depth = np.asarray(image)[2::4, 2::4].astype(np.float32) * 1e-4
        figure = _standing(number).reshape(90, 2, 120, 2).any(axis=(1, 3))
        drawn = np.random.default_rng(paint(pixels, number).sum()).uniform(0.3, 4.0, depth.shape)
        painted = encoded(_painted(pixels, _standing(number), paint, number))
        pose = np.array(entry["transform_matrix"]) @ np.diag([1.0, -1.0, -1.0, 1.0])
        depth = np.where(figure, drawn, depth).astype(np.float32)
        intrinsics = (240.0, 240.0, 120.0, 90.0)
        frames.append(Frame(painted, (240, 180), intrinsics, pose, depth, np.full(depth.shape, 2)))
    return {name.replace(".jpg", ".png"): content for name, content in polycam(frames).items()}


def test_recordings_of_phones_withhold(test_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    masked = []

    def run(task: Task, request: dict[str, Any], *rest: Any) -> dict[str, Any]:
        for number, image in enumerate(request["images"]):
            mask = np.asarray(Image.open(Path(request["mask_folder"]) / f"{image['file']}.png"))
            masked.append(not mask[_standing(number)].any() and bool(mask.any()))
        return run_sandboxed(task, request, *rest)

    monkeypatch.setattr(build, "run_sandboxed", run)
    settings = CaptureSettings(sfm_threads=2, sfm_features=600)
    for name, paint in (("red", _red), ("noise", _noise)):
        for file, content in _recording(test_data / "tabletop", paint).items():
            path = tmp_path / name / "upload" / file
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        capture = _built(tmp_path / name, settings, map(_standing, range(5)))
        assert capture.report.source == "polycam" and capture.report.scale is not None
    assert masked == [True] * 10, "nor has the blank's outline a feature"
    assert _files(tmp_path / "red/upload") != _files(tmp_path / "noise/upload")
    assert _files(tmp_path / "red/capture") == _files(tmp_path / "noise/capture")


@pytest.mark.parametrize(("count", "intervals"), [(24, 8), (2, 80), (7, 3)])
def test_frames_by_place_are_one_an_interval(count: int, intervals: int) -> None:
    numbers = sorted(middle_per_interval(count, intervals))
    assert len(numbers) == min(count, intervals) and numbers[0] >= 0 and numbers[-1] < count
    assert max(np.diff([0, *numbers, count - 1])) <= -(-count // min(count, intervals))
