"""Recordings of phones: their layouts, what is refused in them, and tracked poses that photos refine."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from PIL import Image

from fastsplat.service.capture.build import build_capture
from fastsplat.service.capture.formats.depth_files import DepthFile
from fastsplat.service.capture.formats.depth_maps import load_depth
from fastsplat.service.capture.formats.upload_manifest import read_manifest
from fastsplat.service.capture.sfm.pose_refinement import refusal
from fastsplat.service.capture.untrusted.image_decoder import ImageDecoder
from fastsplat.service.capture.untrusted.sandbox import run_sandboxed
from fastsplat.service.capture.uploads.posed_validation import ImageSizes, read_posed_dataset
from fastsplat.service.capture.uploads.upload_validation import validate_upload
from fastsplat.service.common.progress import silent
from fastsplat.service.common.similarity import fit_similarity
from fastsplat.service.scene.formats.zips import zipped
from fastsplat_contract.errors import CorruptImageError, InvalidInputError, LimitExceededError, ReconstructionError
from tests.capture.phone_recordings import Frame, polycam, record3d_files, scanner_app
from tests.capture.upload_files import captured

_SIZE = (64, 48)
_INTRINSICS = (60.0, 61.0, 31.0, 25.0)


@pytest.fixture
def frames(photo) -> list[Frame]:
    """Four small frames whose poses are all different."""
    phone_frames = []
    for index in range(4):
        pose = np.eye(4)
        pose[:3, :3] = cv2.Rodrigues(np.array([0.3 * index, -1.2, 0.4 + 0.2 * index]))[0]
        pose[:3, 3] = index, 2.0, -1.0
        depth = np.full((12, 16), 1.5 + index / 8, np.float32)
        depth[0, 0] = np.nan
        confidence = np.full((12, 16), 2)
        confidence[:, 0] = 0
        phone_frames.append(Frame(photo(index, _SIZE), _SIZE, _INTRINSICS, pose, depth, confidence))
    return phone_frames


_FORMATS: dict[str, Callable[[list[Frame]], dict[str, bytes]]] = {
    "polycam": polycam,
    "record3d": lambda frames: {"room.r3d": zipped(record3d_files(frames))},
    "arkit": scanner_app,
}


@pytest.mark.parametrize("source", _FORMATS)
def test_layouts(source: str, frames, upload, settings) -> None:
    validated = validate_upload(upload(_FORMATS[source](frames)), settings)
    assert (validated.source, validated.images, validated.warnings) == (source, 4, ())
    manifest, files = read_manifest(validated.folder)
    paths = tuple(photo.path for photo in manifest.photos)
    dataset = read_posed_dataset(files, manifest, ImageSizes(files, paths, settings), settings)
    assert dataset.scale == "METRIC" and dataset.tracked
    for image, frame in zip(dataset.images, frames, strict=True):
        np.testing.assert_allclose(image.world_from_camera, frame.pose, atol=1e-9)
        assert image.camera_model.params == _INTRINSICS
        assert (image.camera_model.width, image.camera_model.height) == _SIZE
        assert image.depth is not None and image.depth.confidence is not None
        assert manifest.depth_sizes[image.path] == (16, 12)


def test_polycam_before_its_poses_were_optimized_and_without_depth(frames, upload, settings) -> None:
    files = {name: content for name, content in polycam(frames, False).items() if "/depth/" not in name}
    validated = validate_upload(upload(files), settings)
    assert (validated.source, validated.images) == ("polycam", 4)
    assert not read_manifest(validated.folder)[0].depth_sizes


def test_record3d_by_frame_intrinsics_and_without_compression(frames, upload, settings) -> None:
    coefficients = [[50.0 + index, 51.0, 32.0, 24.0] for index in range(4)]
    files = record3d_files(frames, perFrameIntrinsicCoeffs=coefficients)
    files["rgbd/2.depth"] = frames[2].depth.astype("<f4").tobytes()
    del files["rgbd/3.conf"], files["rgbd/1.jpg"]
    validated = validate_upload(upload(files), settings)
    assert (validated.source, validated.images) == ("record3d", 3)
    assert "1 of 4 frames" in validated.warnings[0]
    manifest, folder = read_manifest(validated.folder)
    paths = tuple(photo.path for photo in manifest.photos)
    dataset = read_posed_dataset(folder, manifest, ImageSizes(folder, paths, settings), settings)
    assert [image.camera_model.params[0] for image in dataset.images] == [50.0, 52.0, 53.0]


def test_compressed_depth_is_read_in_the_confined_processes(frames, upload, settings, tmp_path: Path) -> None:
    folder = upload({"room.r3d": zipped(record3d_files(frames))})
    for name in ("check", "decode"):
        (tmp_path / name).mkdir()
    request = {"upload": str(folder), "settings": settings.model_dump()}
    run_sandboxed("validate", request, tmp_path / "check", settings, lambda fraction, message: None)
    manifest, files = read_manifest(folder)
    depth = DepthFile("rgbd/2.depth", 1.0, (16, 12), "rgbd/2.conf")
    with ImageDecoder(tmp_path / "decode", (files,), settings) as decoder:
        read = decoder.depth(files, depth, manifest.photos[2], (8, 6))
    assert read.shape == (6, 8) and set(np.unique(read)) <= {0.0, 1.75}
    assert (read[1:, 1:] == 1.75).all()


def test_long_recordings_are_thinned(frames, upload, settings) -> None:
    validated = validate_upload(upload(record3d_files(frames * 3)), settings.model_copy(update={"max_phone_frames": 5}))
    assert validated.images == 5 and "5 of 12 frames" in validated.warnings[0]


def _changed(files: dict[str, bytes], name: str, **changes: Any) -> dict[str, bytes]:
    document = json.loads(files[name])
    for key, value in changes.items():
        document[key] = value
        if value is ...:
            del document[key]
    return {**files, name: json.dumps(document).encode()}


_POLYCAM, _SCANNER = "keyframes/corrected_cameras/1001.json", "scan/frame_00002.json"


@pytest.mark.parametrize(
    ("source", "name", "changes", "text"),
    [
        ("polycam", _POLYCAM, {"t_11": float("nan")}, "t_11 is not a finite number"),
        ("polycam", _POLYCAM, {"t_11": "1"}, "t_11 is not a finite number"),
        ("polycam", _POLYCAM, {"t_23": ...}, "t_23 is not a finite number"),
        ("polycam", _POLYCAM, {"t_00": 9.0}, _POLYCAM),
        ("polycam", _POLYCAM, {"fx": 0}, "focal lengths"),
        ("polycam", _POLYCAM, {"width": 64.5}, "64.5 pixels"),
        ("polycam", _POLYCAM, {"height": 1e12}, "pixels"),
        ("polycam", _POLYCAM, {"width": 48, "height": 64}, "another aspect ratio"),
        ("arkit", _SCANNER, {"cameraPoseARFrame": [0.0] * 16}, "frame_00002.json"),
        ("arkit", _SCANNER, {"cameraPoseARFrame": [1.0] * 15}, "16 finite numbers"),
        ("arkit", _SCANNER, {"cameraPoseARFrame": {"0": 1}}, "16 finite numbers"),
        ("arkit", _SCANNER, {"intrinsics": [True] * 9}, "9 finite numbers"),
        ("record3d", "metadata", {"poses": []}, "no list of poses"),
        ("record3d", "metadata", {"poses": [[0, 0, 0, 0, 1, 2, 3]] * 4}, "quaternion"),
        ("record3d", "metadata", {"poses": [[0, 0, 0, 1, 1, 2]] * 4}, "7 finite numbers"),
        ("record3d", "metadata", {"K": None}, "9 finite numbers"),
        ("record3d", "metadata", {"dw": -1}, "-1 pixels"),
        ("record3d", "metadata", {"w": 10**400}, "w is not a finite number"),
    ],
)
def test_bad_documents(source, name, changes, text, frames, refuses) -> None:
    files = record3d_files(frames) if source == "record3d" else _FORMATS[source](frames)
    refuses(_changed(files, name, **changes), InvalidInputError, text, strict=True)


def test_bad_files(frames, tmp_path: Path, refuses) -> None:
    files = record3d_files(frames)
    deep = b'{"poses": ' + b"[" * 40 + b"]" * 40 + b"}"
    for name, content, kind, text in (
        ("metadata", b"{", InvalidInputError, "metadata is not JSON"),
        ("metadata", deep, InvalidInputError, "nested too deeply"),
        ("metadata", b"[1]", InvalidInputError, "no list of poses"),
        ("rgbd/1.depth", files["rgbd/1.depth"][:20], CorruptImageError, "rgbd/1.depth"),
        ("rgbd/1.depth", b"no depth", CorruptImageError, "rgbd/1.depth"),
        ("rgbd/1.conf", b"", CorruptImageError, "rgbd/1.conf"),
        ("rgbd/1.jpg", b"no photo", CorruptImageError, "rgbd/1.jpg"),
    ):
        refuses({**files, name: content}, kind, text, strict=True)
    refuses(files, LimitExceededError, "metadata has", " bytes", max_json_bytes=100, strict=True)


@pytest.fixture(scope="module")
def tabletop(test_data: Path) -> tuple[list[Frame], list[np.ndarray]]:
    """Ten tabletop photos with pose errors of 1 cm and 0.5°, a sensor's depth 1 % too long, and the true poses."""
    root = test_data / "tabletop"
    document = json.loads((root / "transforms.json").read_text())
    random = np.random.default_rng(1)
    frames, poses = [], []
    for entry in document["frames"][::4]:
        pose = np.array(entry["transform_matrix"]) @ np.diag([1.0, -1.0, -1.0, 1.0])
        tracked = pose.copy()
        tracked[:3, :3] = cv2.Rodrigues(random.normal(size=3) * np.deg2rad(0.5) / np.sqrt(3))[0] @ pose[:3, :3]
        tracked[:3, 3] += random.normal(size=3) * 0.01 / np.sqrt(3)
        with Image.open(root / entry["depth_path"]) as image:
            depth = np.asarray(image)[1::3, 1::3].astype(np.float32) * 1e-4
        depth = 1.01 * depth * random.normal(1, 0.01, depth.shape).astype(np.float32)
        jpeg = (root / entry["file_path"]).read_bytes()
        confidence = np.where(random.random(depth.shape) < 0.1, 0, 2)
        frames.append(Frame(jpeg, (480, 360), (480.0, 480.0, 240.0, 180.0), tracked, depth, confidence))
        poses.append(pose)
    return frames, poses


def _errors(poses: list[np.ndarray], truth: list[np.ndarray]) -> tuple[float, float]:
    """Root mean squares: meters, degrees."""
    relative = [np.linalg.inv(true) @ pose for pose, true in zip(poses, truth, strict=True)]
    cosine = np.clip([(np.trace(matrix[:3, :3]) - 1) / 2 for matrix in relative], -1, 1)
    shift = [np.linalg.norm(matrix[:3, 3]) for matrix in relative]
    return float(np.sqrt(np.mean(np.square(shift)))), float(np.sqrt(np.mean(np.rad2deg(np.arccos(cosine)) ** 2)))


def _shape_error(poses: list[np.ndarray], truth: list[np.ndarray]) -> float:
    """Root mean square distance of the positions, meters, once all are moved and scaled to fit best."""
    ours, true = (np.array([pose[:3, 3] for pose in some]) for some in (poses, truth))
    return float(np.sqrt(((fit_similarity(ours, true).points(ours) - true) ** 2).sum(1).mean()))


def test_photos_refine_tracked_poses_and_keep_meters_and_gravity(tabletop, upload, settings) -> None:
    frames, truth = tabletop
    folder = upload(polycam(frames))
    capture = captured(folder, settings)
    assert capture.scale == "METRIC" and not capture.report.warnings
    scale = capture.report.scale
    assert scale is not None and scale.source == "sensor_depth" and 0.02 <= scale.relative_error_95 < 0.03
    # Meters are the sensor's, which are 1 % too long, within the 2 % that it claims.
    refined = [view.posed.world_from_camera.copy() for view in capture.views]
    spread = [np.linalg.norm(np.std([pose[:3, 3] for pose in poses], axis=0)) for poses in (refined, truth)]
    assert abs(spread[0] / spread[1] - 1.01) < 0.003
    for pose in refined:
        pose[:3, 3] /= 1.01
    before, after = _errors([frame.pose for frame in frames], truth), _errors(refined, truth)
    assert after[0] < 0.8 * before[0] and after[1] < 0.6 * before[1]
    # What is left is the whole's place and size, which only the tracking gives: relative poses are far surer.
    assert _shape_error(refined, truth) < 0.3 * _shape_error([frame.pose for frame in frames], truth)
    # Its maps stay in its meters.
    depth = load_depth(capture.views[0].depth)
    exact = frames[0].depth
    known = depth > 0
    assert 0.85 < known.mean() < 0.95
    assert np.abs(np.median(depth[known] / exact[known]) - 1) < 0.01
    assert len(capture.points) > 4_000


def test_photos_that_have_nothing_to_do_with_the_poses_are_refused(tabletop, upload, settings, refused) -> None:
    frames, _ = tabletop
    mixed = [
        Frame(other_frame.jpeg, frame.size, frame.intrinsics, frame.pose, other_frame.depth, other_frame.confidence)
        for frame, other_frame in zip(frames, [frames[i] for i in (3, 7, 0, 9, 5, 1, 8, 2, 6, 4)], strict=True)
    ]
    folder = upload(polycam(mixed))
    validate_upload(folder, settings)
    with refused(ReconstructionError, "contradict the camera poses"):
        build_capture(folder, folder.parent / "out", settings, silent)


def test_a_refinement_is_refused_that_goes_too_far() -> None:
    positions = np.array([[-1.0, 0, 0], [1.0, 0, 0]])
    near, turned = np.full(2, 0.05), np.full(2, 1.0)
    assert refusal(positions, near, turned, (3, 10), (2, 10)) == ""
    assert "0.30 m" in refusal(positions, 6 * near, turned, (3, 10), (2, 10))
    assert "9.0 degrees" in refusal(positions, near, 9 * turned, (3, 10), (2, 10))
    assert "contradict" in refusal(positions, near, turned, (3, 10), (4, 10))
    assert "too few" in refusal(positions, near[:0], turned[:0], (0, 0), (0, 0))
