"""COLMAP models: text says what binary says, both say what was written, and no count in them is believed."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pycolmap
import pytest

from fastsplat.service.capture.build import build_capture
from fastsplat.service.capture.uploads.colmap_model import read_colmap
from fastsplat.service.capture.uploads.left_out import LeftOut
from fastsplat.service.capture.uploads.upload_validation import validate_upload
from fastsplat.service.common.progress import silent
from fastsplat_contract.errors import InvalidInputError, LimitExceededError
from tests.capture.upload_files import captured

_SIZE = (64, 48)


def _model(folder: Path, names: list[str], *, text: bool, size: tuple[int, int] = _SIZE) -> pycolmap.Reconstruction:
    """Two cameras, poses around the origin, sixty points with tracks."""
    rng = np.random.default_rng(5)
    model = pycolmap.Reconstruction()
    params = {
        1: ("SIMPLE_RADIAL", [50.0, size[0] / 2, size[1] / 2, 0.05]),
        2: ("PINHOLE", [55.0, 56.0, size[0] / 2, size[1] / 2]),
    }
    for camera_id, (name, values) in params.items():
        camera = pycolmap.Camera(camera_id=camera_id, model=name, width=size[0], height=size[1], params=values)
        model.add_camera_with_trivial_rig(camera)
    for index, name in enumerate(names):
        pose = pycolmap.Rigid3d(
            pycolmap.Rotation3d(np.array([0.0, 0.1 * index, 0.0])), np.array([0.1 * index, 0.0, 3.0])
        )
        points2d = pycolmap.Point2DList([pycolmap.Point2D(rng.uniform(0, 40, 2)) for _ in range(60)])
        image = pycolmap.Image(name=name, camera_id=1 + index % 2, image_id=index + 1, points2D=points2d)
        model.add_image_with_trivial_frame(image, pose)
    for index in range(60):
        track = pycolmap.Track(elements=[pycolmap.TrackElement(i + 1, index) for i in range(len(names))])
        model.add_point3D(rng.normal(size=3), track, rng.integers(0, 256, 3).astype(np.uint8))
    folder.mkdir(parents=True, exist_ok=True)
    (model.write_text if text else model.write_binary)(folder)
    return model


_NAMES = ["b.jpg", "a.jpg", "sub dir/c.jpg"]


def _upload(upload, photo, *, text: bool, sparse: str = "sparse/0") -> Path:
    folder = upload({f"images/{name}": photo(i, _SIZE) for i, name in enumerate(_NAMES)})
    _model(folder / sparse, _NAMES, text=text)
    return folder


@pytest.mark.parametrize("sparse", ["sparse/0", "sparse", "."])
@pytest.mark.parametrize("text", [False, True])
def test_round_trip(text: bool, sparse: str, upload, photo, settings) -> None:
    folder = _upload(upload, photo, text=text, sparse=sparse)
    assert validate_upload(folder, settings).source == "colmap"
    read = read_colmap(folder, sparse, "images", settings, LeftOut(strict=True))
    written = _model(folder.parent / "again", _NAMES, text=text)
    assert [image.name for image in read.images] == ["a.jpg", "b.jpg", "sub dir/c.jpg"]
    for posed_image in read.images:
        image = written.find_image_with_name(posed_image.name)
        expected = image.cam_from_world().inverse().matrix()
        np.testing.assert_allclose(posed_image.world_from_camera[:3], expected, atol=1e-9)
        assert (posed_image.camera_model.model, posed_image.camera_model.width) == (
            image.camera.model.name,
            image.camera.width,
        )
        np.testing.assert_allclose(posed_image.camera_model.params, image.camera.params)
    order = sorted(written.points3D)
    by_position = {tuple(np.float32(p)): tuple(c) for p, c in zip(read.points, read.point_colors, strict=True)}
    assert by_position == {tuple(np.float32(written.points3D[i].xyz)): tuple(written.points3D[i].color) for i in order}


def test_built_views_are_undistorted_and_keep_the_world(upload, photo, settings) -> None:
    folder = _upload(upload, photo, text=False)
    capture = captured(folder, settings)
    assert capture.report.source == "colmap"
    assert capture.scale == "ARBITRARY"
    written = pycolmap.Reconstruction(folder / "sparse/0")
    for view in capture.views:
        image = written.find_image_with_name(view.posed.name)
        np.testing.assert_allclose(view.posed.camera_from_world()[:3], image.cam_from_world().matrix(), atol=1e-9)
    assert {
        (view.posed.camera.width, view.posed.camera.fx) for view in capture.views if view.posed.name == "a.jpg"
    } == {(64, 55.0)}
    assert len(capture.points) == 60


@pytest.mark.parametrize("file", ["cameras.bin", "images.bin", "points3D.bin"])
@pytest.mark.parametrize("share", [0.0, 0.35, 0.7, 0.95, None])
def test_cut_short_or_with_false_counts(file: str, share: float | None, upload, photo, settings, refused) -> None:
    folder = _upload(upload, photo, text=False)
    path = folder / "sparse/0" / file
    whole = path.read_bytes()
    path.write_bytes(struct.pack("<Q", 10**12) + whole[8:] if share is None else whole[: int(len(whole) * share)])
    with refused(InvalidInputError, file):
        validate_upload(folder, settings)


def _edit(path: Path, old: str, new: str) -> None:
    before = path.read_text()
    assert old in before
    path.write_text(before.replace(old, new, 1))


@pytest.mark.parametrize(
    ("file", "old", "new", "said"),
    [
        ("cameras.txt", "50 32 24", "0 0 0", "camera 1"),
        ("cameras.txt", "50 32 24", "nan 32 24", "camera 1"),
        ("cameras.txt", "SIMPLE_RADIAL", "EYE", "EYE"),
        ("images.txt", "1 1 0 0 0 0 0 3 1 b.jpg", "1 0 0 0 0 0 0 3 1 b.jpg", "b.jpg"),
        ("images.txt", "1 1 0 0 0 0 0 3 1 b.jpg", "1 1 0 0 0 nan 0 3 1 b.jpg", "b.jpg"),
        ("images.txt", "1 1 0 0 0 0 0 3 1 b.jpg", "1 1 0 0 0 0 0 3 9 b.jpg", "camera 9"),
        ("images.txt", "1 1 0 0 0 0 0 3 1 b.jpg", "1 1 0 0 0 0 0 3 1 lost.jpg", "lost.jpg"),
        ("images.txt", "1 1 0 0 0 0 0 3 1 b.jpg", "1 1 0 0 0 0 0 3 1 ../../../../../etc/passwd", "passwd"),
        ("images.txt", "1 1 0 0 0 0 0 3 1 b.jpg", "1 1 0 0 zero 0 0 3 1 b.jpg", "zero"),
    ],
)
def test_nonsense_is_named(file: str, old: str, new: str, said: str, upload, photo, settings, refused) -> None:
    folder = _upload(upload, photo, text=True)
    _edit(folder / "sparse/0" / file, old, new)
    with refused(InvalidInputError, file, said):
        validate_upload(folder, settings, strict=True)


def test_an_image_that_cannot_be_used_costs_itself(upload, photo, settings) -> None:
    """By its pixels, its camera or its pose; the others are as without it."""
    for file, old, new, names in (
        ("cameras.txt", "50 32 24", "nan 32 24", ["images/b.jpg", "images/sub dir/c.jpg"]),
        ("images.txt", "1 1 0 0 0 0 0 3 1 b.jpg", "1 1 0 0 0 1e300 0 3 1 b.jpg", ["images/b.jpg"]),
        ("images.txt", "1 1 0 0 0 0 0 3 1 b.jpg", "1 1 0 0 0 0 0 3 1 lost.jpg", ["images/lost.jpg"]),
        ("images.txt", "1 1 0 0 0 0 0 3 1 b.jpg", "1 1 0 0 0 0 0 3 1 b.jpg", ["images/b.jpg"]),
    ):
        folder = _upload(upload, photo, text=True)
        if old == new:
            (folder / "images/b.jpg").write_bytes(b"no photo")
        _edit(folder / "sparse/0" / file, old, new)
        validated = validate_upload(folder, settings)
        assert sorted(validated.left_out) == names and validated.images == len(_NAMES) - len(names)
    capture = build_capture(folder, folder.parent / "out", settings, silent)
    assert [view.posed.name for view in capture.views] == ["a.jpg", "sub dir/c.jpg"]
    assert capture.report.left_out == validated.left_out


def test_too_many_points(upload, photo, settings, refused) -> None:
    folder = _upload(upload, photo, text=False)
    with refused(LimitExceededError, "points3D.bin", " points"):
        validate_upload(folder, settings.model_copy(update={"max_model_points": 59}))


def test_intrinsics_for_another_resolution(upload, photo, settings, refused) -> None:
    folder = _upload(upload, photo, text=False)
    (folder / "images/a.jpg").write_bytes(photo(1, (128, 96)))
    validate_upload(folder, settings, strict=True)
    capture = build_capture(folder, folder.parent / "out", settings, silent)
    camera = next(view.posed.camera for view in capture.views if view.posed.name == "a.jpg")
    assert (camera.width, camera.height, camera.fx, camera.fy, camera.cx) == (128, 96, 110.0, 112.0, 64.0)
    (folder / "images/a.jpg").write_bytes(photo(1, (96, 96)))
    with refused(InvalidInputError, "a.jpg", "96×96", "64×48"):
        validate_upload(folder, settings, strict=True)
