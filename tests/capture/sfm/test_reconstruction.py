"""Structure from motion and triangulation on real pictures, in the child process they run in."""

from __future__ import annotations

import io
import json
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from fastsplat.service.capture.build import build_capture, load_image
from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.captures import Capture
from fastsplat.service.capture.formats.image_io import load_rgb
from fastsplat.service.capture.sfm.mapping_snapshots import take_placed
from fastsplat.service.capture.sfm.placed_cameras import PlacedViews, placed_of
from fastsplat.service.capture.uploads.upload_validation import validate_upload
from fastsplat.service.common.progress import ProgressEvent, silent
from fastsplat.service.common.similarity import fit_similarity
from fastsplat_contract.errors import CancelledError, ReconstructionError, ResourceError
from tests.capture.upload_files import captured, encoded, video_file

_FRAMES = range(0, 40, 4)
_PLACED: list[PlacedViews] = []  # what the fixture `tabletop` was shown while images were placed


def _photos(test_data: Path, folder: Path, frames: Sequence[int] = _FRAMES) -> Path:
    (folder / "images").mkdir(parents=True)
    for index in frames:
        shutil.copy(test_data / f"tabletop/images/{index:03d}.jpg", folder / "images")
    return folder


def _truth(test_data: Path, names: Sequence[str]) -> np.ndarray:
    document = json.loads((test_data / "tabletop/transforms.json").read_text())
    poses = {Path(f["file_path"]).name: np.array(f["transform_matrix"]) for f in document["frames"]}
    return np.array([poses[Path(name).name] @ np.diag([1, -1, -1, 1]) for name in names])


@pytest.fixture(scope="module")
def tabletop(test_data: Path, tmp_path_factory) -> tuple[Capture, list[ProgressEvent]]:
    """Ten views of the table top, without their poses."""
    settings = CaptureSettings(sfm_threads=2)
    folder = _photos(test_data, tmp_path_factory.mktemp("sfm") / "upload")
    validate_upload(folder, settings)
    events: list[ProgressEvent] = []
    _PLACED.clear()
    return build_capture(folder, folder.parent / "out", settings, events.append, _PLACED.append), events


def test_poses_agree_with_the_truth_up_to_a_similarity(tabletop, test_data: Path) -> None:
    capture, _ = tabletop
    estimated = np.array([view.posed.world_from_camera for view in capture.views])
    truth = _truth(test_data, [view.posed.name for view in capture.views])
    assert len(estimated) == len(_FRAMES)
    between = [np.linalg.inv(poses[:-1]) @ poses[1:] for poses in (estimated, truth)]
    turn = between[0][:, :3, :3].transpose(0, 2, 1) @ between[1][:, :3, :3]
    angles = np.degrees(np.arccos(np.clip((np.trace(turn, axis1=1, axis2=2) - 1) / 2, -1, 1)))
    assert angles.max() < 1.0
    a, b = estimated[:, :3, 3], truth[:, :3, 3]
    aligned = fit_similarity(a, b).points(a)
    extent = np.linalg.norm(b.max(0) - b.min(0))
    assert np.linalg.norm(aligned - b, axis=1).max() < 0.01 * extent


def test_the_rest_of_the_capture(tabletop) -> None:
    capture, _ = tabletop
    assert capture.report.source == "images" and capture.scale == "ARBITRARY"
    assert capture.report.models == (10,) and capture.report.unregistered == ()
    assert 0 < capture.report.mean_reprojection_error_px < 1
    assert len(capture.points) > 200
    for view in capture.views:
        camera = view.posed.camera
        assert load_image(view).shape == (camera.height, camera.width, 3)
        assert abs(camera.fx / camera.width - 1.0) < 0.03  # rendered with a focal length of the image's width


def test_cameras_are_shown_while_they_are_placed(tabletop) -> None:
    capture, _ = tabletop
    assert _PLACED, "nothing was shown"
    counts = [placed.placed for placed in _PLACED]
    assert counts == sorted(counts) and 2 <= counts[0] < len(_FRAMES)
    names = {view.posed.name for view in capture.views}
    for placed in _PLACED:
        assert not placed.complete and placed.images == len(_FRAMES)
        assert {camera.name for camera in placed.cameras} <= names and len(placed.cameras) == placed.placed
        assert 0 < len(placed.points) == len(placed.colors) <= 5_000 and placed.colors.std() > 5
        distances = [np.linalg.norm(camera.world_from_camera[:3, 3]) for camera in placed.cameras]
        assert np.median(distances) == pytest.approx(3)  # as large as a finished capture
    whole = placed_of(capture)
    assert whole.complete and whole.placed == whole.images == len(_FRAMES)
    assert len(whole.points) == min(5_000, len(capture.points))


def test_what_the_child_left_is_not_trusted(tmp_path: Path) -> None:
    def left(content: bytes) -> Path:
        (tmp_path / "placed.npz").write_bytes(content)
        return tmp_path

    file = io.BytesIO()
    np.savez(file, names=np.array([object()]), allow_pickle=True)
    poses = np.tile(np.eye(4)[:3], (2, 1, 1))
    arrays = {"names": ["a", "b"], "poses": poses, "pinholes": np.full((2, 5), 8.0), "placed": 2}
    bad = io.BytesIO()
    np.savez(bad, points=np.full((3, 3), np.nan), colors=np.zeros((3, 3), np.uint8), **arrays)
    bomb = io.BytesIO()
    np.savez_compressed(bomb, points=np.zeros((500_000, 3)), colors=np.zeros((500_000, 3), np.uint8), **arrays)
    assert len(bomb.getvalue()) < 100_000
    for content in (bomb.getvalue(), b"", b"PK\3\4 no archive", file.getvalue(), bad.getvalue(), bytes(5 << 20)):
        assert take_placed(left(content), {"a": "a.jpg", "b": "b.jpg"}, 2) is None
    good = io.BytesIO()
    arrays["poses"] = poses + np.arange(2)[:, None, None] * np.eye(4)[3]
    np.savez(good, points=np.eye(3) + 5, colors=np.zeros((3, 3), np.uint8), **arrays)
    assert take_placed(left(good.getvalue()), {"a": "a.jpg"}, 2) is None  # a file that nobody gave it
    placed = take_placed(left(good.getvalue()), {"a": "a.jpg", "b": "b.jpg"}, 2)
    assert placed is not None and [camera.name for camera in placed.cameras] == ["a.jpg", "b.jpg"]
    assert take_placed(tmp_path, {}, 2) is None  # taken once


def test_colors_are_the_photos(tabletop) -> None:
    """Each point has, in the views that look at it unobstructed, about the color of the pixel it lands on."""
    capture, _ = tabletop
    differences = []
    for view in capture.views:
        rows, pixels, _ = view.posed.in_picture(capture.points)
        x, y = pixels.astype(int).T
        differences.append(np.abs(load_image(view)[y, x].astype(float) - capture.point_colors[rows]).mean(axis=1))
    assert np.median(np.concatenate(differences)) < 25


def test_progress_goes_forward_through_every_step(tabletop) -> None:
    _, events = tabletop
    assert {event.stage for event in events} == {"capture"}
    fractions = [event.fraction for event in events]
    assert fractions == sorted(fractions) and fractions[-1] == 1.0
    text = " ".join(event.message for event in events)
    for step in ("reading images", "extracting features", "matching image pairs", "registering images", "undistorting"):
        assert step in text


def test_threads_that_match_call_no_blas() -> None:
    """pycolmap's own BLAS is not safe in threads: once in a hundred captures two pairs of images lost their matches."""
    program = """
import ctypes, pycolmap
from fastsplat.service.capture.sfm import reconstruction as sfm
threads = sfm._matching_threads(4)
symbol = sfm._FAISS_BLAS_THRESHOLD
print(threads, ctypes.c_int.in_dll(ctypes.CDLL(pycolmap._core.__file__), symbol).value)
"""
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert result.stdout.split() == ["4", str(2**31 - 1)]


def test_the_same_photos_give_the_same_capture(tabletop, test_data: Path, tmp_path: Path, settings) -> None:
    capture, _ = tabletop
    folder = _photos(test_data, tmp_path / "upload")
    again = captured(folder, settings)
    np.testing.assert_array_equal(again.points, capture.points)
    for first, second in zip(again.views, capture.views, strict=True):
        np.testing.assert_array_equal(first.posed.world_from_camera, second.posed.world_from_camera)


def test_blank_images(upload, settings, refused) -> None:
    blank = encoded(Image.new("RGB", (320, 240), (200, 200, 200)))
    folder = upload({"a.png": blank, "b.png": blank})
    validate_upload(folder, settings)
    with refused(ReconstructionError, "texture"):
        build_capture(folder, folder.parent / "out", settings, silent)


@pytest.mark.parametrize(("limit", "value"), [("sfm_memory_bytes", 450 << 20), ("sfm_seconds", 0)])
def test_limits(upload, photo, settings, refused, limit: str, value: int) -> None:
    folder = upload({"a.png": photo(1, (1600, 1200), "PNG"), "b.png": photo(2, (1600, 1200), "PNG")})
    validate_upload(folder, settings)
    with refused(ResourceError, limit.upper()):
        build_capture(folder, folder.parent / "out", settings.model_copy(update={limit: value}), silent)


def test_cancelling_stops_the_child_and_leaves_nothing(test_data: Path, tmp_path: Path, settings) -> None:
    folder = _photos(test_data, tmp_path / "upload")
    validate_upload(folder, settings)
    before = sorted(tmp_path.rglob("*"))

    def cancel(event: ProgressEvent) -> None:
        if "features" in event.message:
            raise CancelledError("cancelled", hint="")

    with pytest.raises(CancelledError):
        build_capture(folder, tmp_path / "out", settings, cancel)
    assert sorted(tmp_path.rglob("*")) == before


def test_poses_without_points_get_points(test_data: Path, tmp_path: Path, settings) -> None:
    document = json.loads((test_data / "tabletop/transforms.json").read_text())
    del document["labels"], document["split"]
    document["frames"] = [document["frames"][index] for index in _FRAMES]
    for frame in document["frames"]:
        del frame["mask_path"]
    folder = _photos(test_data, tmp_path / "upload")
    (folder / "transforms.json").write_text(json.dumps(document))
    capture = captured(folder, settings)
    assert len(capture.points) > 250
    assert 0 < capture.report.mean_reprojection_error_px < 1
    errors = []
    for view, frame in zip(capture.views, document["frames"], strict=True):
        with Image.open(test_data / "tabletop" / frame["depth_path"]) as image:
            depth = np.asarray(image) * 1e-4
        _, pixels, depths = view.posed.in_picture(capture.points)
        x, y = pixels.astype(int).T
        errors.append(np.abs(depth[y, x] / depths - 1))
    assert np.median(np.concatenate(errors)) < 0.01


def test_poses_that_contradict_the_images(test_data: Path, tmp_path: Path, settings, refused) -> None:
    document = json.loads((test_data / "tabletop/transforms.json").read_text())
    frames = [document["frames"][index] for index in (0, 4, 8, 12)]
    poses = [frame["transform_matrix"] for frame in frames]
    for frame, pose in zip(frames, [*poses[2:], *poses[:2]], strict=True):
        frame.pop("mask_path")
        frame["transform_matrix"] = pose
    folder = _photos(test_data, tmp_path / "upload", (0, 4, 8, 12))
    keep = {key: document[key] for key in ("w", "h", "fl_x", "fl_y", "cx", "cy")}
    (folder / "transforms.json").write_text(json.dumps({**keep, "frames": frames}))
    validate_upload(folder, settings)
    with refused(ReconstructionError, "contradict the camera poses"):
        build_capture(folder, tmp_path / "out", settings, silent)


@pytest.mark.parametrize(("suffix", "code"), [(".avi", "MJPG"), (".mp4", "mp4v")])
def test_video(suffix: str, code: str, test_data: Path, tmp_path: Path, settings) -> None:
    """Every frame three times, twice blurred: the sharp ones are chosen, and the scene is found."""
    order = list(range(0, 40, 5))
    (tmp_path / "upload").mkdir()
    frames = []
    for index in order:
        frame = load_rgb(test_data / f"tabletop/images/{index:03d}.jpg")
        frames += [cv2.blur(frame, (9, 9)), frame, cv2.blur(frame, (9, 9))]
    video_file(tmp_path / "upload" / f"walk{suffix}", frames, code)
    fewer = settings.model_copy(update={"video_frames": len(order)})
    assert validate_upload(tmp_path / "upload", fewer).source == "video"
    capture = build_capture(tmp_path / "upload", tmp_path / "out", fewer, silent)
    names = {*(view.posed.name for view in capture.views), *capture.report.unregistered}
    assert names == {f"frame_{3 * i + 1:06d}.png" for i in range(len(order))}
    assert capture.report.source == "video" and len(capture.views) >= len(order) - 1


def test_photos_that_are_all_damaged_end_the_capture_with_a_reason(upload, photo, settings) -> None:
    folder = upload({"a.jpg": photo(1), "b.jpg": photo(2)})
    files = validate_upload(folder, settings).folder / "files"
    for path in sorted(files.iterdir()):
        content = path.read_bytes()
        path.unlink()
        path.write_bytes(content[:300])
    with pytest.raises(ReconstructionError, match="hardly one of 2 photos") as caught:
        build_capture(folder, folder.parent / "out", settings, silent)
    assert caught.value.hint and not (folder.parent / "out").exists()
