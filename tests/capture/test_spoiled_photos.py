"""Whatever is wrong with some photos of a capture costs these photos: all others have a place, and each is named."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest
from PIL import ExifTags, Image

from fastsplat.service.capture.build import build_capture
from fastsplat.service.capture.sfm.impossible_cameras import take_out_impossible
from fastsplat.service.capture.uploads.upload_validation import validate_upload
from fastsplat.service.common.progress import silent
from fastsplat_contract.errors import ReconstructionError

_GOOD = range(0, 40, 3)
_HUGE = 40_000_000


def _jpeg(pixels: np.ndarray, **options: object) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, "JPEG", quality=92, **options)
    return stream.getvalue()


def _exif(focal_35mm: float, orientation: int = 1) -> Image.Exif:
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation], exif[ExifTags.Base.Model] = orientation, "another"
    exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.FocalLengthIn35mmFilm] = focal_35mm
    return exif


def _through_another_lens(pixels: np.ndarray) -> np.ndarray:
    """As a lens with strong barrel distortion shows it."""
    height, width = pixels.shape[:2]
    x, y = np.meshgrid((np.arange(width) - width / 2) / width, (np.arange(height) - height / 2) / width)
    factor = 1 + 1.5 * (x**2 + y**2)
    at = [(part * factor * width + side / 2).astype(np.float32) for part, side in ((x, width), (y, height))]
    return np.asarray(cv2.remap(pixels, *at, cv2.INTER_LINEAR))


def _forty_megapixels(pixels: np.ndarray) -> bytes:
    scale = (_HUGE / (pixels.shape[0] * pixels.shape[1])) ** 0.5
    return _jpeg(np.asarray(cv2.resize(pixels, None, fx=scale, fy=scale, interpolation=cv2.INTER_LINEAR)))


_SPOILED: dict[str, Callable[[np.ndarray, np.ndarray], bytes]] = {
    "black": lambda good, foreign: _jpeg(np.zeros_like(good)),
    "white": lambda good, foreign: _jpeg(np.full_like(good, 255)),
    "tiny": lambda good, foreign: _jpeg(np.asarray(Image.fromarray(good).resize((16, 12)))),
    "duplicate": lambda good, foreign: _jpeg(good, subsampling=2),
    "rotated": lambda good, foreign: _jpeg(np.ascontiguousarray(np.rot90(good))),
    "foreign": lambda good, foreign: _jpeg(foreign),
    "lens": lambda good, foreign: _jpeg(_through_another_lens(good)),
    "lying": lambda good, foreign: _jpeg(good, exif=_exif(300.0)),
    "absurd": lambda good, foreign: _jpeg(good, exif=_exif(60_000.0, 77)),
    "huge": lambda good, foreign: _forty_megapixels(good),
    "crop": lambda good, foreign: _jpeg(np.ascontiguousarray(good[20:340, 150:300])),
}
_POINTS = b"""ply
format ascii 1.0
element vertex 1
property float x
property float y
property float z
end_header
0 0 -2
"""
_DAMAGED: dict[str, Callable[[bytes], bytes]] = {
    "truncated": lambda whole: whole[: len(whole) // 3],
    "garbage": lambda whole: whole[:200] + bytes(range(256)) * 20,
    "text": lambda whole: b"This is no photo.\n" * 50,
}


def _capture(folder: Path, names: list[str], test_data: Path, settings):
    """Of fourteen good photos and those with these faults; files that are damaged were whole when they were checked."""
    settings = settings.model_copy(update={"max_side": 480, "sfm_features": 2_000})
    images = folder / "upload" / "images"
    images.mkdir(parents=True)
    photos = [(test_data / f"tabletop/images/{index:03d}.jpg").read_bytes() for index in _GOOD]
    for index, content in zip(_GOOD, photos, strict=True):
        (images / f"{index:03d}.jpg").write_bytes(content)
    foreign = np.asarray(Image.open(test_data / "kitchen/images/05.jpg").convert("RGB"))
    for number, name in enumerate(names):
        content = photos[3 * number % len(photos)]
        if name in _SPOILED:
            content = _SPOILED[name](np.asarray(Image.open(io.BytesIO(content))), foreign)
        (images / f"{name}.jpg").write_bytes(content)
    files = validate_upload(images.parent, settings).folder / "files"
    for name in _DAMAGED.keys() & set(names):
        path = files / "images" / f"{name}.jpg"
        content = _DAMAGED[name](path.read_bytes())
        path.unlink()  # a link to what was sent
        path.write_bytes(content)
    return build_capture(images.parent, folder / "out", settings, silent)


@pytest.mark.parametrize(
    "names",
    [
        ["truncated", "black", "tiny", "foreign", "lying", "crop"],
        ["garbage", "text", "white", "duplicate", "rotated", "lens", "absurd", "huge"],
    ],
    ids=lambda names: names[0],
)
def test_spoiled_photos_cost_themselves_and_are_named(names: list[str], test_data: Path, tmp_path, settings) -> None:
    capture = _capture(tmp_path, names, test_data, settings)
    good, spoiled = {f"{index:03d}.jpg" for index in _GOOD}, {f"{name}.jpg" for name in names}
    placed = {view.posed.name for view in capture.views}
    assert good <= placed <= good | spoiled
    report = capture.report
    verdicts = {verdict.name: verdict for verdict in report.photos}
    assert verdicts.keys() == good | spoiled and report.images == len(verdicts)
    assert set(report.unregistered) == verdicts.keys() - placed
    for name in spoiled - placed:
        assert verdicts[name].not_placed is not None and verdicts[name].advice.endswith(".")
    for name in good:
        assert verdicts[name].placed and set(verdicts[name].defects) <= {"duplicate"}  # of a spoiled copy
    reasons = {name.removesuffix(".jpg"): verdict.not_placed for name, verdict in verdicts.items()}
    assert {reasons[name] for name in _DAMAGED.keys() & set(names)} == {"unreadable"}
    assert {reasons[name] for name in {"black", "white", "tiny"} & set(names)} == {"few_features"}
    assert {reasons[name] for name in {"foreign"} & set(names)} <= {"no_overlap", "few_matches", "other_model"}
    if "duplicate" in names:
        copied = f"{3 * names.index('duplicate') * 3 % 42:03d}.jpg"
        assert verdicts["duplicate.jpg"].duplicate_of == copied or verdicts[copied].duplicate_of == "duplicate.jpg"


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


def test_a_camera_of_the_upload_that_folds_the_picture_costs_its_photo(upload, photo, settings) -> None:
    poses = [np.eye(4).tolist()] * 3
    frames = [{"file_path": f"{number}.jpg", "transform_matrix": pose} for number, pose in enumerate(poses)]
    frames[1] |= {"fl_x": 40.0, "fl_y": 40.0, "k1": -0.9}
    camera = {"w": 64, "h": 48, "fl_x": 60.0, "fl_y": 60.0, "cx": 32.0, "cy": 24.0}
    document = json.dumps({**camera, "frames": frames}).encode()
    files = {f"{number}.jpg": photo(number) for number in range(3)}
    folder = upload({**files, "transforms.json": document, "points3d.ply": _POINTS})
    validate_upload(folder, settings)
    capture = build_capture(folder, folder.parent / "out", settings, silent)
    assert [view.posed.name for view in capture.views] == ["0.jpg", "2.jpg"]
    assert capture.report.unregistered == ("1.jpg",) and capture.report.images == 3
    assert [verdict.not_placed for verdict in capture.report.photos] == [None, "lens", None]


def _own_cameras(folder: Path) -> pycolmap.Reconstruction:
    """Eight images, each with a camera of its own, and what they see."""
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_cameras_per_rig, options.num_frames_per_rig = 8, 1, 1
    options.num_points3D = 60
    pycolmap.set_random_seed(0)
    with pycolmap.Database.open(folder / "features.db") as writer:
        return pycolmap.synthesize_dataset(options, writer)


def _runaway(image: pycolmap.Image) -> None:
    camera = image.camera
    camera.width, camera.height = 219, 463
    camera.params = np.array([365.67, 109.5, 231.5, -0.5187])  # as bundle adjustment left it once


def _lens_of(*params: float) -> Callable[[pycolmap.Image], None]:
    def change(image: pycolmap.Image) -> None:
        image.camera.params = np.array(params)

    return change


def _lost(image: pycolmap.Image) -> None:
    pose = np.array(image.frame.rig_from_world.matrix())
    pose[1, 3] = np.nan
    image.frame.rig_from_world = pycolmap.Rigid3d(pose)


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (_runaway, "lens"),
        (_lens_of(90_000.0, 512, 384, 0.0), "lens"),
        (_lens_of(90.0, 512, 384, 0.0), "lens"),
        (_lens_of(np.nan, 512, 384, 0.0), "lens"),
        (_lens_of(1280.0, 512, 384, np.inf), "lens"),
        (_lens_of(1280.0, -9e9, 384, 0.0), "lens"),
        (_lost, "unknown"),
    ],
)
def test_an_impossible_camera_leaves_with_its_observations_and_no_other(tmp_path: Path, spoil, reason: str) -> None:
    model = _own_cameras(tmp_path)
    spoiled = model.images[3]
    before = {image.name: image.cam_from_world().matrix() for image in model.images.values()}
    spoil(spoiled)
    assert take_out_impossible([model], 1600) == {spoiled.name: reason}
    after = {image.name: image.cam_from_world().matrix() for image in model.images.values() if image.has_pose}
    assert after.keys() == before.keys() - {spoiled.name}
    assert all(np.array_equal(after[name], before[name]) for name in after)
    seen_by = {element.image_id for point in model.points3D.values() for element in point.track.elements}
    assert model.num_points3D() > 50 and spoiled.image_id not in seen_by
    assert all(point.track.length() >= 2 for point in model.points3D.values())
    assert take_out_impossible([model], 1600) == {}
