"""Pixels that are withheld enter nothing: two captures that differ only there are the same capture."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from numpy.typing import NDArray
from PIL import Image

from fastsplat.service.capture.build import build_capture
from fastsplat.service.capture.capture_settings import CaptureSettings, PhotoSettings
from fastsplat.service.capture.captures import Capture
from fastsplat.service.capture.formats.depth_maps import load_depth
from fastsplat.service.capture.formats.image_io import load_rgb
from fastsplat.service.capture.photos.camera_model import CameraModel, compute_undistortion
from fastsplat.service.capture.photos.scene_photos import photo_path, write_photos
from fastsplat.service.capture.photos.withholding import BLANK, Withholding
from fastsplat.service.capture.sfm.features import extract_features
from fastsplat.service.capture.uploads.upload_validation import validate_upload
from fastsplat.service.capture.views.view_writer import DEPTHS, IMAGES, MASKS, SourceImage, write_view
from fastsplat.service.common.dictionary import Dictionary
from fastsplat.service.common.progress import silent
from fastsplat.service.perception.results import Labelling
from fastsplat.service.splatting.training.train import train
from fastsplat.service.splatting.training_settings import TrainingSettings
from fastsplat_contract.geometry.camera import Camera
from fastsplat_contract.jobs.operations import Privacy

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
    document = json.loads((source / "transforms.json").read_text())
    document["frames"] = document["frames"][:: len(document["frames"]) // _VIEWS][:_VIEWS]
    document.pop("split")
    for key in ("w", "fl_x", "cx", "h", "fl_y", "cy"):
        document[key] = document[key] * _SIZE[0] / 480
    document["w"], document["h"] = _SIZE
    (folder / "images").mkdir(parents=True)
    for number, frame in enumerate(document["frames"]):
        pixels = np.asarray(Image.open(source / frame["file_path"]).resize(_SIZE, Image.Resampling.BOX))
        frame.pop("depth_path"), frame.pop("mask_path")
        frame["file_path"] = f"images/{number:03d}.png"
        Image.fromarray(_painted(pixels, _figure(number), paint, number)).save(folder / frame["file_path"])
    document["ply_file_path"] = "points3d.ply"
    (folder / "points3d.ply").write_bytes((source / "points3d.ply").read_bytes())
    (folder / "transforms.json").write_text(json.dumps(document))
    return folder


def _red(pixels: NDArray[np.uint8], number: int) -> NDArray[np.uint8]:
    return np.broadcast_to(np.array([250, 10, 10], np.uint8), pixels.shape)


def _noise(pixels: NDArray[np.uint8], number: int) -> NDArray[np.uint8]:
    return np.random.default_rng(number).integers(0, 256, pixels.shape, dtype=np.uint8)


def _painted(pixels: NDArray[np.uint8], mask: Mask, paint: Paint, number: int) -> NDArray[np.uint8]:
    return np.where(mask[..., None], paint(pixels, number), pixels)


def _capture(test_data: Path, folder: Path, paint: Paint, privacy: Privacy | None):
    """The capture, by a detector that says of each photo in turn where the figure is."""
    figures: Iterator[int] = iter(range(_VIEWS))
    withholding = Withholding(lambda pixels: _figure(next(figures)), privacy)
    upload = validate_upload(_upload(test_data / "tabletop", folder / "upload", paint), CaptureSettings())
    return build_capture(upload.folder, folder / "capture", CaptureSettings(), silent, None, withholding)


def _files(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def _splat(capture: Capture) -> bytes:
    settings = TrainingSettings(iterations=40, time_budget_s=None, max_gaussians=2_000, max_side=60, held_out_every=0)
    trained = train(capture, Labelling(Dictionary(()), ()), settings, silent)
    stream = io.BytesIO()
    np.savez(stream, **vars(trained.gaussians))
    return stream.getvalue()


def test_what_privacy_withholds_makes_no_difference_to_anything(test_data: Path, tmp_path: Path) -> None:
    red = _capture(test_data, tmp_path / "red", _red, "people")
    noise = _capture(test_data, tmp_path / "noise", _noise, "people")
    assert _files(tmp_path / "red/upload") != _files(tmp_path / "noise/upload")
    assert _files(tmp_path / "red/capture") == _files(tmp_path / "noise/capture")
    assert _splat(red) == _splat(noise)
    for name, capture in (("red", red), ("noise", noise)):
        (tmp_path / name / "version").mkdir()
        write_photos(capture, tmp_path / name / "version", PhotoSettings())
    assert _files(tmp_path / "red/version") == _files(tmp_path / "noise/version")
    stored = load_rgb(photo_path(tmp_path / "red/version", _WALKING[0]))
    assert np.abs(stored[_figure(_WALKING[0])].astype(int) - BLANK).mean() < 8  # JPEG


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


def test_features_lie_outside_of_what_is_withheld(test_data: Path, tmp_path: Path) -> None:
    images, masks = tmp_path / "images", tmp_path / "masks"
    images.mkdir(), masks.mkdir()
    (images / "a.jpg").write_bytes((test_data / "tabletop/images/000.jpg").read_bytes())
    (images / "b.jpg").write_bytes((test_data / "tabletop/images/001.jpg").read_bytes())
    usable = np.full((360, 480), 255, np.uint8)
    usable[100:300, 100:380] = 0
    Image.fromarray(usable).save(masks / "a.jpg.png")  # b has none

    def keypoints(name: str, folder: Path | None) -> dict[str, NDArray[np.float64]]:
        database = tmp_path / f"{name}.db"
        pycolmap.Database.open(database).close()
        options = pycolmap.FeatureExtractionOptions()
        options.num_threads = 1
        extract_features(database, images, ["a.jpg", "b.jpg"], folder, options)
        with pycolmap.Database.open(database) as reader:
            rows = reader.read_all_images()
            return {row.name: np.asarray(reader.read_keypoints(row.image_id))[:, :2] for row in rows}

    def inside(points: NDArray[np.float64]) -> int:
        column, row = points.astype(int).T
        return int((usable[row.clip(0, 359), column.clip(0, 479)] == 0).sum())

    everywhere, masked = keypoints("all", None), keypoints("masked", masks)
    assert inside(everywhere["a.jpg"]) > 50 and inside(masked["a.jpg"]) == 0 and len(masked["a.jpg"]) > 20
    assert len(masked["b.jpg"]) == len(everywhere["b.jpg"])


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
