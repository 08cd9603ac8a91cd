"""nerfstudio's transforms.json: conventions, intrinsics, points, label maps, and all that can be wrong with it."""

from __future__ import annotations

import io
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

from fastsplat.service.capture.build import build_capture, load_image
from fastsplat.service.capture.formats.capture_files import load_capture
from fastsplat.service.capture.uploads.upload_validation import validate_upload
from fastsplat.service.common.progress import silent
from fastsplat_contract.errors import FastSplatError, InvalidInputError, ReconstructionError
from tests.capture.upload_files import PINHOLE, captured, encoded, frames_of, points_file, turned

_SIZE = (64, 48)
_POINTS = points_file((0, 0, 1), (1, 2, 3))


def _document(frame: dict[str, Any] | None = None, **changes: Any) -> dict[str, Any]:
    """Of three frames that all have the values of `frame`."""
    frames = [entry | (frame or {}) for entry in frames_of(f"images/{i}.jpg" for i in range(3))]
    return {"w": 64, "h": 48, "fl_x": 60.0, "fl_y": 61.0, "cx": 31.0, "cy": 25.0, "frames": frames, **changes}


@pytest.fixture
def send(upload, photo) -> Callable[..., Path]:
    def write(document: Any, **files: bytes) -> Path:
        text = document if isinstance(document, str) else json.dumps(document)
        images = {f"images/{i}.jpg": photo(i, _SIZE) for i in range(3)}
        return upload({**images, "transforms.json": text.encode(), "points3d.ply": _POINTS, **files})

    return write


def test_tabletop_points_land_on_their_pixels(test_data: Path, settings, tmp_path: Path) -> None:
    """Its points were triangulated, its depth maps rendered: both agree only if every convention does."""
    document = json.loads((test_data / "tabletop" / "transforms.json").read_text())
    frames = document["frames"][::8]
    document["split"] = {"test": ["016"]}
    document["frames"] = frames
    folder = tmp_path / "place" / "upload"
    for file in ["points3d.ply", *(frame[key] for frame in frames for key in ("file_path", "mask_path"))]:
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        (folder / file).write_bytes((test_data / "tabletop" / file).read_bytes())
    (folder / "transforms.json").write_text(json.dumps(document))
    capture = captured(folder, settings)
    assert capture.scale == "METRIC"
    assert capture.test_names == ("images/016.jpg",)
    assert len(capture.points) == 4955
    agreeing = visible = 0
    for view, frame in zip(capture.views, frames, strict=True):
        with Image.open(test_data / "tabletop" / frame["depth_path"]) as image:
            depth = np.asarray(image).astype(float) * 1e-4
        _, pixels, depths = view.posed.in_picture(capture.points)
        x, y = pixels.astype(int).T
        near = np.abs(depth[y, x] - depths) < 0.02 * depths
        agreeing, visible = agreeing + near.sum(), visible + len(near)
    assert agreeing > 0.7 * visible > 5_000
    labels = capture.given_labels
    assert labels is not None and labels.dictionary.label_of(13) == "mug"
    with Image.open(test_data / "tabletop" / frames[2]["mask_path"]) as image:
        np.testing.assert_array_equal(np.asarray(Image.open(labels.map_paths[2])), np.asarray(image))


def test_intrinsics_forms(send, settings) -> None:
    angle = 2 * math.atan(32 / 60)
    forms = {
        "global": (_document(), (60.0, 61.0)),
        "angle": (_document(fl_x=None, fl_y=None, camera_angle_x=angle), (60.0, 60.0)),
        "doubled": (_document(w=128, h=96, fl_x=120.0, fl_y=122.0, cx=62.0, cy=50.0), (60.0, 61.0)),
    }
    for document, focal in forms.values():
        camera = captured(send(document), settings).views[0].posed.camera
        np.testing.assert_allclose((camera.fx, camera.fy), focal)
        assert (camera.width, camera.height) == _SIZE
    per_frame = _document()
    per_frame["frames"][1] |= {"fl_x": 80.0}
    cameras = [view.posed.camera for view in captured(send(per_frame), settings).views]
    assert [camera.fx for camera in cameras] == [60.0, 80.0, 60.0]
    for bent in (_document(k1=0.05, p1=0.001), _document(camera_model="OPENCV_FISHEYE", k1=0.02), _document(k3=0.01)):
        camera = captured(send(bent), settings).views[0].posed.camera
        np.testing.assert_allclose((camera.fx, camera.fy), (60.0, 61.0))
        assert (camera.cx, camera.cy) != (31.0, 25.0)


def test_untouched_pixels_are_kept_exactly(send, settings) -> None:
    folder = send(_document())
    capture = captured(folder, settings)
    for view, name in zip(capture.views, ("0", "1", "2"), strict=True):
        with Image.open(folder / f"images/{name}.jpg") as image:
            np.testing.assert_array_equal(load_image(view), np.asarray(image.convert("RGB")))


def test_a_rotated_phone_photo_with_poses(upload, photo, settings) -> None:
    """Poses are for stored pixels: the view is upright, and a ray still ends on the same colour."""
    pixels = photo(4, _SIZE, "PNG", exif=turned(6))
    document = _document(frames=frames_of(["a.png"]))
    view = captured(
        upload({"a.png": pixels, "transforms.json": json.dumps(document).encode(), "points3d.ply": _POINTS}), settings
    ).views[0]
    assert (view.posed.camera.width, view.posed.camera.height) == _SIZE[::-1]
    with Image.open(io.BytesIO(pixels)) as image:
        stored = np.asarray(image)
    upright = load_image(view)
    for u, v in ((5.5, 7.5), (60.5, 40.5), (31.5, 2.5)):
        x, y = view.posed.pixels(np.array([(u - 31.0) / 60.0, -(v - 25.0) / 61.0, -1.0]))
        np.testing.assert_array_equal(upright[int(y), int(x)], stored[int(v), int(u)])


def test_each_view_has_the_exposure_that_its_photo_tells(send, photo, settings) -> None:
    """2 EV between 1/100 and 1/25 of a second, and nothing of a photo without EXIF."""
    named = {}
    for name, seconds in (("images/0.jpg", 100), ("images/1.jpg", 25)):
        exif = Image.Exif()
        exif.get_ifd(0x8769).update({0x829A: IFDRational(1, seconds), 0x829D: IFDRational(2, 1), 0x8827: 400})
        named[name] = photo(1, _SIZE, "JPEG", exif=exif)
    folder = send(_document(), **named)
    captured(folder, settings)
    first, second, third = (view.exposure_ev for view in load_capture(folder.parent / "out").views)
    assert second - first == pytest.approx(2) and third is None


def test_capture_survives_the_disk(send, settings) -> None:
    masks = {f"masks/{i}.png": encoded(np.eye(48, 64, dtype=np.uint8) * 3) for i in range(3)}
    document = _document(labels={"cup": 3}, k1=0.05, fl_y=60.0)
    for i, frame in enumerate(document["frames"]):
        frame["mask_path"] = f"masks/{i}.png"
    folder = send(document, **masks)
    built, loaded = captured(folder, settings), load_capture(folder.parent / "out")
    assert built.report == loaded.report and built.given_labels == loaded.given_labels
    np.testing.assert_array_equal(built.points, loaded.points)
    for view, loaded_view in zip(built.views, loaded.views, strict=True):
        assert (view.posed.camera, view.image_path) == (loaded_view.posed.camera, loaded_view.image_path)
        assert view.lens == loaded_view.lens and view.lens is not None and view.lens.k1 == pytest.approx(0.05)
        np.testing.assert_array_equal(view.posed.world_from_camera, loaded_view.posed.world_from_camera)
    assert {path.name for path in folder.parent.iterdir()} == {"upload", "out"}
    (moved := folder.parent / "elsewhere").parent.joinpath("out").rename(moved)
    assert load_image(load_capture(moved).views[0]).shape[2] == 3


def test_masks_without_labels_are_ignored_pixels(send, settings) -> None:
    mask = np.zeros((48, 64), np.uint8)
    mask[:, 32:] = 255
    document = _document()
    document["frames"][1]["mask_path"] = "m.png"
    capture = captured(send(document, **{"m.png": encoded(mask)}), settings)
    assert capture.given_labels is None and capture.views[0].valid_path is None
    with Image.open(capture.views[1].valid_path) as image:
        np.testing.assert_array_equal(np.asarray(image), mask)
    assert "mask" in capture.report.warnings[0]


def test_frames_without_their_image_are_skipped(send, settings) -> None:
    """As public data sets have them; a split and label maps may speak of them too."""
    document = _document(split={"test": ["1", "lost/8.jpg"]})
    document["frames"] += [{"file_path": f"lost/{name}", "transform_matrix": "none"} for name in ("8.jpg", "9")]
    ids = encoded(np.ones((48, 64), np.uint8))
    labels = {"labels.json": b'["mug"]', "labels/images/0.png": ids, "labels/lost/8.png": ids}
    folder = send(document, **labels)
    warning = "2 of 5 frames of transforms.json are skipped, as their images are missing: lost/8.jpg, lost/9."
    assert validate_upload(folder, settings).warnings == (warning,)
    capture = build_capture(folder, folder.parent / "out", settings, silent)
    assert [view.posed.name for view in capture.views] == [f"images/{i}.jpg" for i in range(3)]
    assert capture.report.warnings == (warning,) and capture.test_names == ("images/1.jpg",)
    assert capture.given_labels is not None and [path is not None for path in capture.given_labels.map_paths] == [
        1,
        0,
        0,
    ]


def test_a_long_list_of_missing_images_is_cut(send, settings) -> None:
    document = _document()
    document["frames"] += frames_of(f"{i:03d}{'x' * 300}.jpg" for i in range(100))
    folder = send(document)
    (warning,) = validate_upload(folder, settings.model_copy(update={"min_frames_present": 0.02})).warnings
    assert "100 of 103" in warning and "004" in warning and "005" not in warning and "and 95 more" in warning
    assert len(warning) < 600


@pytest.mark.parametrize(
    ("missing", "share", "usable"), [(3, 0.5, True), (4, 0.5, False), (4, 0.4, True), (1, 1, False)]
)
def test_too_few_images_present(missing: int, share: float, usable: bool, send, settings, refused) -> None:
    document = _document()
    document["frames"] += frames_of(f"{i}.jpg" for i in range(missing))
    folder, limited = send(document), settings.model_copy(update={"min_frames_present": share})
    if usable:
        assert validate_upload(folder, limited).images == 3
    else:
        with refused(InvalidInputError, f"{missing} of {3 + missing} frames", "0.jpg", "a share of"):
            validate_upload(folder, limited)
    none = send(_document(frames=frames_of(["lost.jpg"])))
    with refused(InvalidInputError, "1 of 1", "lost.jpg"):
        validate_upload(none, settings.model_copy(update={"min_frames_present": 0.0}))


def test_a_document_beside_the_images_folder(upload, photo, settings) -> None:
    document = _document()
    for frame in document["frames"]:
        frame["file_path"] = f"../{frame['file_path']}"
    files = {f"images/{i}.jpg": photo(i, _SIZE) for i in range(3)}
    folder = upload({**files, "poses/transforms.json": json.dumps(document).encode(), "poses/points3d.ply": _POINTS})
    assert [view.posed.name for view in captured(folder, settings).views] == [f"../images/{i}.jpg" for i in range(3)]


def test_images_that_are_masked_entirely_are_left_out(send, settings) -> None:
    """They teach nothing, and nothing can be measured on them."""
    masks = {f"m{i}.png": encoded(np.full((48, 64), 255 * (i != 1), np.uint8)) for i in range(3)}
    document = _document(split={"test": ["1", "2"]})
    for i, frame in enumerate(document["frames"]):
        frame["mask_path"] = f"m{i}.png"
    capture = captured(send(document, **masks), settings)
    assert [view.posed.name for view in capture.views] == ["images/0.jpg", "images/2.jpg"]
    assert capture.test_names == ("images/2.jpg",)
    assert any("1 of 3 images" in warning and "images/1.jpg" in warning for warning in capture.report.warnings)
    assert all(path.stem != "00001" for path in capture.views[0].image_path.parent.parent.rglob("*"))


def test_masks_that_leave_nothing_are_refused(send, settings, refused) -> None:
    """Or leave nothing once images are smaller."""
    mask, small = np.zeros((48, 64), np.uint8), settings.model_copy(update={"max_side": 16})
    folder = send(_document({"mask_path": "m.png"}), **{"m.png": encoded(mask)})
    with refused(InvalidInputError, "masks", "0 everywhere"):
        validate_upload(folder, settings)
    mask[0, 0] = 255
    (folder / "m.png").write_bytes(encoded(mask))
    validate_upload(folder, small)
    with refused(ReconstructionError, "mask"):
        build_capture(folder, folder.parent / "out", small, silent)


def _pose(**cells: float) -> list[list[float]]:
    pose = np.eye(4)
    for cell, value in cells.items():
        pose[int(cell[1]), int(cell[2])] = value
    return pose.tolist()


@pytest.mark.parametrize(
    "pose",
    [None, "eye", [], [[1, 0, 0, 0]], _pose(m03=float("nan")), _pose(m03=float("inf")), _pose(m00=0.0), _pose(m00=2.0),
     _pose(m00=-1.0), _pose(m30=1.0), [[1, 0, 0, "0"]] * 4, [[True, 0, 0, 0]] * 4, np.zeros((4, 4)).tolist()],
    ids=str,
)  # fmt: skip
def test_invalid_poses_are_refused(pose: Any, send, settings, refused) -> None:
    document = _document()
    document["frames"][1]["transform_matrix"] = pose
    folder = send(document)
    with refused(InvalidInputError, "transforms.json", "images/1.jpg"):
        validate_upload(folder, settings, strict=True)


@pytest.mark.parametrize(
    ("document", "said"),
    [
        ("[1, 2", "transforms.json"),
        ("3", "frames"),
        ({"frames": []}, "frames"),
        ({"frames": [7]}, "frame 0"),
        ("[" * 100_000, "nested"),
        ('{"frames": ' + "[" * 40 + "]" * 40 + "}", "nested"),
        ("\x00\xff", "transforms.json"),
        (_document(fl_x=None), "focal length"),
        (_document(fl_x=float("nan")), "fl_x"),
        (_document(fl_x="60"), "fl_x"),
        (_document(fl_x=-60), "focal"),
        (_document(fl_x=10**400), "fl_x"),
        (_document(w=0), "0×48"),
        (_document(w=48), "48×48"),
        (_document(camera_model="LOMO"), "LOMO"),
        (_document(camera_model="PINHOLE", k1=0.1), "PINHOLE"),
        (_document(convention="directx"), "directx"),
        (_document(convention="opencv, world-to-camera"), "world-to-camera"),
        (_document(frames=frames_of(["images/9.jpg"])), "images/9.jpg"),
        (_document(frames=frames_of(["../../../../etc/passwd"])), "passwd"),
        (_document(frames=frames_of(["images/0.jpg"] * 2)), "same file"),
        (_document(frames=frames_of(["x" * 5_000])), "5000 characters"),
        (_document(frames=frames_of(["transforms.json"])), "not an image"),
        (_document(split={"test": ["7"]}), "'7'"),
        (_document(ply_file_path="lost.ply"), "lost.ply"),
        (_document(labels={"mug": 0.5}), "mug"),
    ],
    ids=lambda value: str(value)[:50],
)
def test_invalid_documents_are_refused(document: Any, said: str, send, settings, refused) -> None:
    folder = send(document)
    with refused(InvalidInputError, said):
        validate_upload(folder, settings, strict=True)


def test_each_frame_that_cannot_be_used_costs_itself_alone(send, photo, settings) -> None:
    """By its image, its name, its pose, its camera or its mask; a split may speak of it; the rest is as without it."""
    frames = {
        "images/far.jpg": {"transform_matrix": _pose(m03=1e308)},
        "images/endless.jpg": {"transform_matrix": _pose(m13=float("inf"))},
        "images/bent.jpg": {"transform_matrix": _pose(m00=2.0)},
        "images/blind.jpg": {"fl_x": -4},
        "images/masked.jpg": {"mask_path": "cut.png"},
        "images/cut.jpg": {},
        "images/text.jpg": {},
        "": {},
        "y" * 9_000: {},
    }
    images = {name: photo(7, _SIZE) for name in frames if 0 < len(name) < 100}
    images |= {"images/cut.jpg": photo(8, (640, 480))[:2_000], "images/text.jpg": b"text", "cut.png": b"x"}
    document = _document(split={"test": ["images/1.jpg", "images/far.jpg", "images/cut.jpg"]})
    document["frames"] += [{"file_path": name, "transform_matrix": _pose()} | rest for name, rest in frames.items()]
    document["frames"].append({"file_path": "images/2.jpg", "transform_matrix": _pose()})
    folder = send(document, **images)
    left_out = validate_upload(folder, settings).left_out
    names = {f"frame {number} of transforms.json" for number in (10, 11, 12)} | {*images} - {"cut.png"}
    assert set(left_out) == names and all(reason and name not in reason for name, reason in left_out.items())
    assert "9000 characters" in left_out["frame 11 of transforms.json"]
    capture = build_capture(folder, folder.parent / "out", settings, silent)
    assert [view.posed.name for view in capture.views] == [f"images/{i}.jpg" for i in range(3)]
    assert capture.test_names == ("images/1.jpg",) and load_capture(folder.parent / "out").report.left_out == left_out
    for name, rest in frames.items():
        document = _document(frames=[*_document()["frames"], {"file_path": name, "transform_matrix": _pose()} | rest])
        with pytest.raises(FastSplatError):
            validate_upload(send(document), settings, strict=True)


@pytest.mark.parametrize("applied", [np.zeros((3, 4)).tolist(), [[1]], "none", [[10**400] * 4] * 3])
def test_an_applied_transform_that_is_none_is_refused(applied: Any, send, settings, refused) -> None:
    folder = send(_document(applied_transform=applied))
    with refused(InvalidInputError, "transforms.json", "applied_transform"):
        validate_upload(folder, settings)


def test_a_camera_of_the_upload_that_folds_the_picture_costs_its_photo(upload, photo, settings) -> None:
    frames = frames_of(f"{number}.jpg" for number in range(3))
    frames[1] |= {"fl_x": 40.0, "fl_y": 40.0, "k1": -0.9}
    document = json.dumps({**PINHOLE, "frames": frames}).encode()
    files = {f"{number}.jpg": photo(number) for number in range(3)}
    folder = upload({**files, "transforms.json": document, "points3d.ply": points_file((0, 0, -2))})
    capture = captured(folder, settings)
    assert [view.posed.name for view in capture.views] == ["0.jpg", "2.jpg"]
    assert capture.report.unregistered == ("1.jpg",) and capture.report.images == 3
    assert [verdict.not_placed for verdict in capture.report.photos] == [None, "lens", None]
