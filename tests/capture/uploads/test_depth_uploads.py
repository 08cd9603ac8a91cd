"""Depth maps of uploads: their units, their place in the capture, and all that can be wrong with them."""

from __future__ import annotations

import io
import json
import sys
from pathlib import Path
from typing import Any

import lzfse
import numpy as np
import pytest

from fastsplat.service.capture.build import build_capture
from fastsplat.service.capture.formats.capture_files import load_capture
from fastsplat.service.capture.formats.depth_files import DepthFile, read_depth
from fastsplat.service.capture.formats.depth_maps import load_depth, save_depth
from fastsplat.service.capture.uploads.upload_validation import validate_upload
from fastsplat.service.common.progress import silent
from fastsplat_contract.errors import CorruptImageError, InvalidInputError, LimitExceededError, MissingPackageError
from fastsplat_contract.geometry.camera import Camera
from tests.capture.upload_files import PINHOLE, captured, encoded, frames_of, points_file, turned


def _npy(array: Any) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array, allow_pickle=True)
    return stream.getvalue()


def _ramp(width: int = 32, height: int = 24) -> np.ndarray:
    """Millimeters: 1 m at the left to 2 m at the right; unknown in the top row."""
    ramp = np.tile(np.linspace(1000, 2000, width), (height, 1)).astype(np.uint16)
    ramp[0] = 0
    return ramp


@pytest.fixture
def send(upload, photo):
    """An upload of three photos of 64×48 with these depth maps and changes of the document."""

    def write(
        maps: list[bytes],
        suffix: str = "png",
        depth_names: list[str] | None = None,
        points: bytes = points_file((0, 0, -2)),
        **changes: Any,
    ) -> Path:
        names = depth_names or [f"depth/{index}.{suffix}" for index in range(len(maps))]
        frames = frames_of(f"images/{i}.jpg" for i in range(3))
        for frame, name in zip(frames, names, strict=False):
            frame["depth_file_path"] = name
        files = {f"depth/{index}.{suffix}": content for index, content in enumerate(maps)}
        images = {f"images/{i}.jpg": photo(i) for i in range(3)}
        text = json.dumps({**PINHOLE, "frames": frames, **changes}).encode()
        return upload({**images, **files, "transforms.json": text, "points3d.ply": points})

    return write


def test_millimeters_become_sensor_depth_and_points(send, settings) -> None:
    capture = captured(send([encoded(_ramp())] * 2), settings)
    assert [view.depth is not None for view in capture.views] == [True, True, False]
    sensor = capture.views[0].depth
    assert (sensor.camera.width, sensor.camera.height, sensor.camera.fx) == (32, 24, 30.0)
    np.testing.assert_allclose(load_depth(sensor), _ramp() / 1000, atol=2e-5)
    assert load_depth(sensor)[0].max() == 0
    # The identity of OpenGL's axes looks along -z: points lie 1 to 2 m in front of it, the upload's own point first.
    assert len(capture.points) > 500 and (capture.points[0] == [0, 0, -2]).all()
    z, x = -capture.points[1:, 2], capture.points[1:, 0]
    column = x / z * 30 + 16
    np.testing.assert_allclose(z, 1 + (column - 0.5) / 31, atol=2e-3)
    again = load_capture(sensor.path.parents[1])
    assert again.views[0].depth == sensor and again.views[2].depth is None


def test_units_and_arrays(send, settings) -> None:
    meters = _ramp().astype(np.float32) / 1000
    strange = meters.copy()
    strange[1, :5] = np.nan, np.inf, -1.0, 1e30, 1e4
    maps = [_npy(strange), _npy(meters.astype(np.float64)[..., None]), _npy(meters.astype(np.float16))]
    capture = captured(send(maps, "npy", depth_unit_scale_factor=1), settings)
    loaded = [load_depth(view.depth) for view in capture.views]
    assert (loaded[0][1, :5] == 0).all() and loaded[0].max() < 2.01
    np.testing.assert_allclose(loaded[1], meters, atol=2e-5)
    np.testing.assert_allclose(loaded[2], meters, atol=2e-3)


def _points_on_the_ramp(share: float) -> bytes:
    """150 points where `_ramp` is for the identity of OpenGL's axes, in a world of which a unit is 1 / share meters."""
    random = np.random.default_rng(0)
    column, row = random.integers(2, 30, 150), random.integers(2, 22, 150)
    z = share * _ramp()[row, column] / 1000
    xyz = np.stack([(column + 0.5 - 16) / 30 * z, -(row + 0.5 - 12) / 30 * z, -z], axis=1)
    return points_file(*xyz)


def test_depth_in_meters_tells_the_unit_of_poses_and_points(send, settings) -> None:
    capture = captured(send([encoded(_ramp())] * 3, points=_points_on_the_ramp(0.25)), settings)
    assert capture.scale == "METRIC"
    scale = capture.report.scale
    assert scale.source == "sensor_depth" and abs(scale.meters_per_unit - 4) < 0.01
    assert 0.02 <= scale.relative_error_95 < 0.021
    assert -capture.points[:150, 2].max() > 1 and -capture.points[:150, 2].min() < 2.01
    np.testing.assert_allclose(load_depth(capture.views[0].depth), _ramp() / 1000, rtol=3e-3, atol=1e-4)


@pytest.mark.parametrize("outliers", [0, 1, 7])
def test_a_few_outliers_cost_no_precision_of_the_others(tmp_path: Path, outliers: int) -> None:
    true = np.random.default_rng(0).uniform(1.0, 1.6, (24, 32)).astype(np.float32)
    depth = true.copy()
    depth.ravel()[:outliers] = 900.0
    stored = load_depth(save_depth(depth, Camera(32, 24, 30.0, 30.0, 16.0, 12.0), tmp_path / "0.png"))
    assert (stored.ravel()[:outliers] == 0).all()  # unknown
    assert np.abs(stored - true).ravel()[outliers:].max() < 1e-4


def test_a_far_view_that_is_no_outlier_stays_known(tmp_path: Path) -> None:
    depth = np.full((24, 32), 1.5, np.float32)
    depth[:, :2] = 40.0  # through a door
    stored = load_depth(save_depth(depth, Camera(32, 24, 30.0, 30.0, 16.0, 12.0), tmp_path / "0.png"))
    np.testing.assert_allclose(stored, depth, rtol=1e-3)


def test_a_map_that_cannot_be_read_any_more_costs_the_map_alone(send, settings) -> None:
    folder = send([encoded(_ramp())] * 3)
    files = validate_upload(folder, settings).folder / "files"
    (files / "depth/1.png").unlink()  # a link to what was sent
    (files / "depth/1.png").write_bytes(encoded(_ramp())[:-40])
    capture = build_capture(folder, folder.parent / "out", settings, silent)
    assert [view.depth is None for view in capture.views] == [False, True, False]
    assert any("depth/1.png" in warning for warning in capture.report.warnings)


def test_metric_poses_keep_their_unit(send, settings) -> None:
    upload = send([encoded(_ramp())] * 3, points=_points_on_the_ramp(0.95), scale="metric")
    capture = captured(upload, settings)
    assert capture.scale == "METRIC" and capture.report.scale is None and not capture.report.warnings
    np.testing.assert_allclose(load_depth(capture.views[0].depth), 0.95 * _ramp() / 1000, rtol=3e-3, atol=1e-4)


def test_maps_that_contradict_metric_poses_are_not_used(send, settings) -> None:
    upload = send([encoded(_ramp())] * 3, points=_points_on_the_ramp(0.25), scale="metric")
    capture = captured(upload, settings)
    assert all(view.depth is None for view in capture.views) and len(capture.points) == 150
    assert any("4 times as far" in warning for warning in capture.report.warnings)


def test_the_map_of_a_turned_photo_turns_with_it(send, settings, photo, tmp_path) -> None:
    folder = send([encoded(_ramp())])
    (folder / "images" / "0.jpg").write_bytes(photo(0, exif=turned(6)))
    capture = captured(folder, settings)
    view = capture.views[0]
    assert (view.posed.camera.width, view.posed.camera.height) == (48, 64)
    np.testing.assert_allclose(load_depth(view.depth), np.rot90(_ramp(), -1) / 1000, atol=2e-5)
    assert (view.depth.camera.width, view.depth.camera.height) == (24, 32)


def test_large_maps_are_reduced_by_nearest_neighbors(send, settings) -> None:
    steps = np.where(np.arange(1280) < 640, 1000, 3000).astype(np.uint16)[None].repeat(960, 0)
    capture = captured(send([encoded(steps)]), settings)
    depth = load_depth(capture.views[0].depth)
    assert depth.shape == (480, 640)
    assert np.allclose(np.unique(depth), [1, 3], atol=1e-4)


def test_an_empty_map_is_left_out_with_a_warning(send, settings) -> None:
    folder = send([encoded(np.zeros((24, 32), np.uint16)), encoded(_ramp())])
    validated = validate_upload(folder, settings)
    capture = build_capture(folder, folder.parent / "out", settings, silent)
    assert capture.views[0].depth is None and capture.views[1].depth is not None
    assert "1 depth maps" in validated.warnings[0] and "images/0.jpg" in validated.warnings[0]
    assert validated.warnings[0] in capture.report.warnings


def test_confidence_and_compressed_floats(tmp_path, settings) -> None:
    depth = np.linspace(1, 2, 12, dtype=np.float32).reshape(3, 4)
    levels = np.array([[0, 1, 2, 2]] * 3, np.uint8)
    (tmp_path / "0.depth").write_bytes(lzfse.compress(depth.tobytes()))
    (tmp_path / "0.conf").write_bytes(lzfse.compress(levels.tobytes()))
    (tmp_path / "0.png").write_bytes(encoded(levels * 127))
    for confidence in ("0.conf", "0.png"):
        read = read_depth(tmp_path, DepthFile("0.depth", 1.0, (4, 3), confidence), settings)
        np.testing.assert_array_equal(read, np.where(levels > 0, depth, 0))
    bomb = lzfse.compress(bytes(1 << 20))
    assert len(bomb) < 5_000
    (tmp_path / "1.depth").write_bytes(bomb)
    for file, text in (
        (DepthFile("1.depth", 1.0, (4, 3)), "unpacks to"),
        (DepthFile("0.conf", 1.0, (4, 3)), "0.conf"),
        (DepthFile("0.depth", 1.0, (4, 3), "1.depth"), "1.depth"),
    ):
        with pytest.raises(CorruptImageError, match=text):
            read_depth(tmp_path, file, settings)
    (tmp_path / "2.depth").write_bytes(bytes(1 << 20))
    with pytest.raises(CorruptImageError, match="more than it may unpack to"):
        read_depth(tmp_path, DepthFile("2.depth", 1.0, (4, 3)), settings)


def test_without_the_package_that_unpacks_it_the_refusal_names_the_extra(tmp_path, settings, monkeypatch) -> None:
    (tmp_path / "0.depth").write_bytes(lzfse.compress(np.ones((3, 4), np.float32).tobytes()))
    monkeypatch.setitem(sys.modules, "lzfse", None)
    with pytest.raises(MissingPackageError) as caught:
        read_depth(tmp_path, DepthFile("0.depth", 1.0, (4, 3)), settings)
    assert caught.value.field == "0.depth" and "fastsplat[phones]" in caught.value.hint


class _Evil:
    def __reduce__(self) -> Any:
        return (print, ("run",))


@pytest.mark.parametrize(
    ("content", "suffix", "kind", "text"),
    [
        (encoded(_ramp(32, 32)), "png", InvalidInputError, "another aspect ratio"),
        (encoded(np.zeros((24, 32, 3), np.uint8)), "png", InvalidInputError, "8 bits"),
        (encoded(_ramp())[:-40], "png", CorruptImageError, "depth/0.png"),
        (b"no image", "png", CorruptImageError, "depth/0.png"),
        (_npy(np.ones((24, 32, 3), np.float32)), "npy", CorruptImageError, "shape"),
        (_npy(np.ones((24, 32), np.float32))[:-8], "npy", CorruptImageError, "not a readable array"),
        (_npy(np.array([[_Evil()]], object)), "npy", CorruptImageError, "not a readable array"),
        (_npy(np.ones((24, 32), np.complex64)), "npy", CorruptImageError, "not an array of depths"),
        (_npy(np.zeros((0, 32), np.float32)), "npy", CorruptImageError, "not"),
        (b"\x93NUMPY\x01\x00" + b"\xff\xff" + b"(" * 65535, "npy", CorruptImageError, "not a readable array"),
        (encoded(np.zeros((2400, 3200), np.uint16)), "png", LimitExceededError, "3200×2400"),
        (_npy(np.zeros((1200, 1600), np.uint8)), "npy", LimitExceededError, "1600×1200"),
    ],
)
def test_bad_maps_are_refused(send, settings, refused, content: bytes, suffix: str, kind: Any, text: str) -> None:
    folder = send([content], suffix)
    with refused(kind, text, "depth/0"):
        validate_upload(folder, settings.model_copy(update={"max_image_pixels": 1_300_000}), strict=True)


def test_bad_documents_are_refused(send, settings, refused, tmp_path) -> None:
    (tmp_path / "secret.png").write_bytes(encoded(_ramp()))
    for names, text in (
        (["../../secret.png"], "not in the upload"),
        (["/etc/passwd.png"], "not in the upload"),
        (["depth/9.png"], "names the depth map 'depth/9.png'"),
        (["depth/0.exr"], "'.exr'"),
        ([7], "not text"),
    ):
        folder = send([encoded(_ramp())], depth_names=names)
        with refused(InvalidInputError, text):
            validate_upload(folder, settings, strict=True)
    for unit in (0, -0.001, "m", True, [1], 1e9, float("nan"), float("inf")):
        folder = send([encoded(_ramp())], depth_unit_scale_factor=unit)
        with refused(InvalidInputError, "depth unit", "depth_unit_scale_factor"):
            validate_upload(folder, settings, strict=True)
