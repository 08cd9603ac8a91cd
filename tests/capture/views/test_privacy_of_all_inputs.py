"""The promise of privacy holds for every kind of upload: whatever withheld pixels hold, the same bytes are stored."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from PIL import Image

from fastsplat.service.capture import build
from fastsplat.service.capture.build import build_capture
from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.captures import Capture
from fastsplat.service.capture.formats.image_io import load_rgb
from fastsplat.service.capture.formats.upload_manifest import read_manifest
from fastsplat.service.capture.photos.lens_faces import FACES
from fastsplat.service.capture.photos.panorama import full_frame, panorama_faces, wrapped
from fastsplat.service.capture.photos.video import middle_per_interval
from fastsplat.service.capture.photos.withholding import BLANK, WithheldPixels, Withholding
from fastsplat.service.capture.sfm.sfm_images import SfmImage, upright_photos
from fastsplat.service.capture.untrusted.image_decoder import ImageDecoder
from fastsplat.service.capture.untrusted.sandbox import Task, run_sandboxed
from fastsplat.service.capture.uploads.upload_validation import validate_upload
from fastsplat.service.common.progress import silent
from tests.capture import made_room
from tests.capture.phone_recordings import Frame, polycam
from tests.capture.upload_files import encoded, video_file
from tests.capture.views.test_withholding import Mask, Paint, _figure, _files, _noise, _painted, _red, _splat, _upload


def _withholding(masks: Iterator[Mask]) -> Withholding:
    """By a detector that says of each picture in turn where somebody is."""
    return Withholding(lambda pixels: next(masks), "people")


def _built(folder: Path, settings: CaptureSettings, masks: Iterator[Mask]) -> Capture:
    upload = validate_upload(folder / "upload", settings)
    return build_capture(upload.folder, folder / "capture", settings, silent, None, _withholding(masks))


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


def test_posed_photos_withhold_their_depths_and_labels(test_data: Path, tmp_path: Path) -> None:
    splats = []
    for seed, (name, paint) in enumerate((("red", _red), ("noise", _noise))):
        folder = _upload(test_data / "tabletop", tmp_path / name / "upload", paint)
        _with_maps(test_data / "tabletop", folder, seed)
        capture = _built(tmp_path / name, CaptureSettings(), map(_figure, range(6)))
        assert all(view.depth is not None for view in capture.views) and capture.given_labels is not None
        splats.append(_splat(capture))
    assert _files(tmp_path / "red/capture") == _files(tmp_path / "noise/capture")
    assert splats[0] == splats[1]
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
