"""Fisheye photos: pinhole views that show what the lens saw, with and without poses, and lenses that cannot be."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pycolmap
import pytest

from fastsplat.service.capture.build import load_image
from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.photos.camera_model import CameraModel
from fastsplat.service.capture.photos.lens_faces import face_rays, fisheye_faces, is_fisheye
from fastsplat.service.capture.uploads.upload_validation import validate_upload
from fastsplat_contract.errors import InvalidInputError
from tests.capture import made_room
from tests.capture.upload_files import captured, encoded, points_file, valid_pixels

_W, _H = 320, 240
_EXTRA = {
    "OPENCV_FISHEYE": (0.02, -0.004, 0.0, 0.0),
    "FISHEYE": (),
    "SIMPLE_FISHEYE": (),
    "SIMPLE_RADIAL_FISHEYE": (0.01,),
    "RADIAL_FISHEYE": (0.01, -0.002),
    "THIN_PRISM_FISHEYE": (0.01, -0.002, 0.0005, -0.0005, 0.0, 0.0, 0.0004, -0.0003),
}
_ONE_FOCAL = ("SIMPLE_FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE")


def _lens(model: str, degrees: float, width: int = _W, height: int = _H) -> CameraModel:
    """A lens that is `degrees` wide, but for its distortion."""
    focal = width / np.radians(degrees)
    params = (focal, width / 2, height / 2) if model in _ONE_FOCAL else (focal, focal, width / 2, height / 2)
    return CameraModel(model, width, height, (*params, *_EXTRA[model]))


def _rays(lens: CameraModel) -> np.ndarray:
    camera = pycolmap.Camera(model=lens.model, width=lens.width, height=lens.height, params=list(lens.params))
    x, y = np.meshgrid(np.arange(lens.width) + 0.5, np.arange(lens.height) + 0.5)
    rays = camera.cam_ray_from_img(np.column_stack([x.ravel(), y.ravel()]))
    return np.asarray(rays).reshape(lens.height, lens.width, 3)


@pytest.mark.parametrize("model", sorted(_EXTRA))
@pytest.mark.parametrize("degrees", [80, 110, 150, 175])
def test_faces_show_what_the_lens_saw(model: str, degrees: float) -> None:
    lens, pose = _lens(model, degrees), made_room.pose((0.4, 0.2, 1.3), 35, -12)
    photo = made_room.photo(pose, _rays(lens))
    wide = fisheye_faces(lens, 200, "x")
    assert is_fisheye(lens) and len(wide.faces) == (5 if degrees > 120 else 1)
    assert degrees < 100 or abs(wide.field_of_view_deg - degrees) < 0.06 * degrees
    assert wide.covered > (0.8 if degrees <= 120 else 0.95)
    for face in wide.faces:
        camera = face.undistortion.camera
        assert max(camera.width, camera.height) <= 200
        picture = face.undistortion.apply(photo)
        valid = face.undistortion.valid(lens.width, lens.height)
        valid = np.ones(picture.shape[:2], bool) if valid is None else valid
        made_room.check_picture(picture, valid, camera, face.pose(pose))
        assert valid.any(axis=0).all() and valid.any(axis=1).all(), "no row or column shows nothing"
        assert picture[~valid].size == 0 or picture[~valid].max() == 0


def test_outside_of_the_image_circle_nothing_is_valid() -> None:
    lens = _lens("OPENCV_FISHEYE", 200)
    circle = CameraModel(lens.model, lens.width, lens.height, lens.params, circle_px=100.0)
    assert circle.scaled_to(_W // 2, _H // 2).circle_px == 50.0
    radius = np.hypot(*(np.indices((_H, _W)) + 0.5 - np.array([_H, _W])[:, None, None] / 2))
    photo = np.repeat(np.where(radius <= 100, 200, 7).astype(np.uint8)[..., None], 3, axis=2)
    for face in fisheye_faces(circle, 200, "x").faces:
        valid = face.undistortion.valid(_W, _H)
        picture = face.undistortion.apply(photo)
        assert picture[np.ones(picture.shape[:2], bool) if valid is None else valid].mean() > 195
    assert fisheye_faces(circle, 200, "x").field_of_view_deg < fisheye_faces(lens, 200, "x").field_of_view_deg


@pytest.mark.parametrize("distortion", [(-9.0, 0, 0, 0), (50.0, -100.0, 0, 0), (0, 0, 0, -100.0)])
def test_what_folds_is_left_out_or_refused(distortion: tuple[float, ...]) -> None:
    """Where a polynomial turns back, two directions share a pixel: no face goes beyond."""
    lens = CameraModel("OPENCV_FISHEYE", _W, _H, (120.0, 120.0, _W / 2, _H / 2, *map(float, distortion)))
    try:
        wide = fisheye_faces(lens, 200, "frame 3")
    except InvalidInputError as error:
        assert "frame 3" in error.message and error.hint  # noqa: PT017 - to refuse it is right too
        return
    camera = pycolmap.Camera(model=lens.model, width=_W, height=_H, params=list(lens.params))
    for face in wide.faces:
        rays = face_rays(face.undistortion.camera).reshape(-1, 3) @ face.camera_from_face.T
        angle = np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2])
        valid = face.undistortion.valid(_W, _H)
        used = angle if valid is None else angle[valid.ravel()]
        line = np.linspace(0, used.max(), 500)
        radii = camera.img_from_cam(np.stack([np.sin(line), 0 * line, np.cos(line)], axis=1))[:, 0]
        assert (np.diff(radii) > 0).all()


def _posed(upload, lens: CameraModel, **values: object) -> tuple[Path, dict[str, np.ndarray]]:
    poses = {f"{name}.png": made_room.pose((0.2 * index, 0.1, 1.3), 40 * index) for index, name in enumerate("ab")}
    rays = _rays(lens)
    fx, fy, cx, cy, *distortion = lens.params
    document = {
        "camera_model": "OPENCV_FISHEYE", "w": _W, "h": _H, "fl_x": fx, "fl_y": fy, "cx": cx, "cy": cy,
        **dict(zip(("k1", "k2", "k3", "k4"), distortion, strict=True)), **values,
        "ply_file_path": "points.ply", "convention": "opencv", "scale": "metric",
        "frames": [{"file_path": name, "transform_matrix": pose.tolist()} for name, pose in poses.items()],
    }  # fmt: skip
    files = {name: encoded(made_room.photo(pose, rays)) for name, pose in poses.items()}
    files |= {"transforms.json": json.dumps(document).encode(), "points.ply": points_file((0, 0, 1))}
    return upload(files), poses


def test_posed_wide_photos_become_faces(upload, settings) -> None:
    folder, poses = _posed(upload, _lens("OPENCV_FISHEYE", 160), test_filenames=["b.png"])
    capture = captured(folder, settings)
    names = [view.posed.name for view in capture.views]
    faces = ("front", "right", "left", "up", "down")
    assert names == [f"{photo}.{face}.png" for photo in "ab" for face in faces]
    assert capture.test_names == tuple(f"b.{face}.png" for face in faces)
    for view in capture.views:
        assert np.array_equal(view.posed.world_from_camera[:3, 3], poses[f"{view.posed.name[0]}.png"][:3, 3])
        made_room.check_picture(load_image(view), valid_pixels(view), view.posed.camera, view.posed.world_from_camera)
    assert any("5 views" in warning and "fisheye" in warning for warning in capture.report.warnings)
    assert [photo.name for photo in capture.report.photos] == sorted(names) and capture.report.images == 10


def test_posed_photos_up_to_120_degrees_stay_one_view(upload, settings) -> None:
    folder, poses = _posed(upload, _lens("OPENCV_FISHEYE", 112), fisheye_crop_radius=110)
    capture = captured(folder, settings)
    assert [view.posed.name for view in capture.views] == ["a.png", "b.png"]
    for view in capture.views:
        valid = valid_pixels(view)
        made_room.check_picture(load_image(view), valid, view.posed.camera, poses[view.posed.name])
        assert 0.5 < valid.mean() < 0.98, "the corners are outside of the image circle"
    assert any("one view" in warning for warning in capture.report.warnings)


@pytest.mark.parametrize("values", [{"fisheye_crop_radius": -3}, {"fisheye_crop_radius": "all"}, {"k1": 1e9}])
def test_lenses_that_cannot_be_are_refused(upload, settings, refused, values: dict[str, object]) -> None:
    folder, _ = _posed(upload, _lens("OPENCV_FISHEYE", 112), **values)
    with refused(InvalidInputError, "frame 0"):
        validate_upload(folder, settings)


def test_wide_photos_without_poses_find_their_places(tmp_path: Path) -> None:
    """The lens is known to be a fisheye, its focal length is not: 150° instead of the 120° that are tried first."""
    lens = _lens("OPENCV_FISHEYE", 150, 360, 270)
    rays, count, truth = _rays(lens), 5, {}
    (tmp_path / "upload").mkdir()
    for index in range(count):
        turn = 1.2 * index / count
        pose = made_room.pose((1.2 * np.cos(turn), 0.9 * np.sin(turn), 1.3), np.degrees(turn) + 180, 6 - 3 * index)
        truth[f"{index}.front.jpg"] = pose
        (tmp_path / f"upload/{index}.jpg").write_bytes(encoded(made_room.photo(pose, rays), "JPEG", quality=95))
    settings = CaptureSettings(sfm_threads=2, sfm_features=700, lens="fisheye")
    capture = captured(tmp_path / "upload", settings)
    front = [view for view in capture.views if view.posed.name in truth]
    assert len(front) == count and len(capture.views) == 5 * count
    estimated = np.array([view.posed.world_from_camera for view in front])
    true = np.array([truth[view.posed.name] for view in front])
    turns = [np.linalg.inv(poses[:-1, :3, :3]) @ poses[1:, :3, :3] for poses in (estimated, true)]
    errors = np.trace(turns[0].transpose(0, 2, 1) @ turns[1], axis1=1, axis2=2)
    assert np.degrees(np.arccos(np.clip((errors - 1) / 2, -1, 1))).max() < 0.5
    steps = [np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1) for poses in (estimated, true)]
    np.testing.assert_allclose(steps[0] / steps[0].sum(), steps[1] / steps[1].sum(), rtol=0.03)
