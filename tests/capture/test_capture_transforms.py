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

from fastsplat.service.capture import admit_upload, build_capture, load_capture, load_image
from fastsplat.service.capture.ply_points import read_points
from fastsplat.service.common.progress import silent
from fastsplat_contract.errors import FastSplatError, InvalidInputError, LimitExceededError

_SIZE = (64, 48)
_POINTS = b"""ply
format ascii 1.0
element vertex 2
property float x
property float y
property float z
end_header
0 0 1
1 2 3
"""


def _document(**changes: Any) -> dict[str, Any]:
    frames = [{"file_path": f"images/{i}.jpg", "transform_matrix": np.eye(4).tolist()} for i in range(3)]
    return {"w": 64, "h": 48, "fl_x": 60.0, "fl_y": 61.0, "cx": 31.0, "cy": 25.0, "frames": frames, **changes}


@pytest.fixture
def send(upload, photo) -> Callable[..., Path]:
    def write(document: Any, **files: bytes) -> Path:
        text = document if isinstance(document, str) else json.dumps(document)
        images = {f"images/{i}.jpg": photo(i, _SIZE) for i in range(3)}
        return upload({**images, "transforms.json": text.encode(), "points3d.ply": _POINTS, **files})

    return write


def _build(folder: Path, settings) -> Any:
    admit_upload(folder, settings)
    return build_capture(folder, folder.parent / "out", settings, silent)


def _png(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(array).save(stream, "PNG")
    return stream.getvalue()


def test_axes(send, settings) -> None:
    """A camera at (1, 2, 3) that looks along world -z with y up: OpenGL's identity."""
    pose = np.eye(4)
    pose[:3, 3] = 1, 2, 3
    opengl, opencv = _document(), _document(convention="opencv")
    for frame in opengl["frames"]:
        frame["transform_matrix"] = pose.tolist()
    for frame in opencv["frames"]:
        frame["transform_matrix"] = (pose @ np.diag([1, -1, -1, 1])).tolist()
    for document in (opengl, opencv):
        for view in _build(send(document), settings).views:
            x, y, z = view.posed.camera_from_world() @ [1.5, 2.5, 1.0, 1.0] @ np.eye(4)[:, :3]
            np.testing.assert_allclose([x, y, z], [0.5, -0.5, 2.0], atol=1e-12)


def test_tabletop_points_land_on_their_pixels(test_data: Path, settings, tmp_path: Path) -> None:
    """Its points were triangulated, its depth maps rendered: both agree only if every convention does."""
    document = json.loads((test_data / "tabletop" / "transforms.json").read_text())
    chosen = document["frames"][::8]
    document["split"] = {"test": ["016"]}
    document["frames"] = chosen
    folder = tmp_path / "place" / "upload"
    for file in ["points3d.ply", *(frame[key] for frame in chosen for key in ("file_path", "mask_path"))]:
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        (folder / file).write_bytes((test_data / "tabletop" / file).read_bytes())
    (folder / "transforms.json").write_text(json.dumps(document))
    capture = _build(folder, settings)
    assert capture.scale == "METRIC"
    assert capture.test_names == ("images/016.jpg",)
    assert len(capture.points) == 4955
    agreeing = seen = 0
    for view, frame in zip(capture.views, chosen, strict=True):
        camera = view.posed.camera
        with Image.open(test_data / "tabletop" / frame["depth_path"]) as image:
            depth = np.asarray(image).astype(float) * 1e-4
        there = np.column_stack([capture.points, np.ones(4955)]) @ view.posed.camera_from_world().T
        front = there[there[:, 2] > 0.05]
        u = np.floor(camera.fx * front[:, 0] / front[:, 2] + camera.cx).astype(int)
        v = np.floor(camera.fy * front[:, 1] / front[:, 2] + camera.cy).astype(int)
        inside = (u >= 0) & (v >= 0) & (u < camera.width) & (v < camera.height)
        near = np.abs(depth[v[inside], u[inside]] - front[inside, 2]) < 0.02 * front[inside, 2]
        agreeing, seen = agreeing + near.sum(), seen + len(near)
    assert agreeing > 0.7 * seen > 5_000
    given = capture.given_labels
    assert given is not None and given.dictionary.label_of(13) == "mug"
    with Image.open(test_data / "tabletop" / chosen[2]["mask_path"]) as image:
        np.testing.assert_array_equal(np.asarray(Image.open(given.map_paths[2])), np.asarray(image))


def test_intrinsics_forms(send, settings) -> None:
    angle = 2 * math.atan(32 / 60)
    forms = {
        "global": (_document(), (60.0, 61.0)),
        "angle": (_document(fl_x=None, fl_y=None, camera_angle_x=angle), (60.0, 60.0)),
        "doubled": (_document(w=128, h=96, fl_x=120.0, fl_y=122.0, cx=62.0, cy=50.0), (60.0, 61.0)),
    }
    for document, focal in forms.values():
        camera = _build(send(document), settings).views[0].posed.camera
        np.testing.assert_allclose((camera.fx, camera.fy), focal)
        assert (camera.width, camera.height) == _SIZE
    own = _document()
    own["frames"][1] |= {"fl_x": 80.0}
    cameras = [view.posed.camera for view in _build(send(own), settings).views]
    assert [camera.fx for camera in cameras] == [60.0, 80.0, 60.0]
    for bent in (_document(k1=0.05, p1=0.001), _document(camera_model="OPENCV_FISHEYE", k1=0.02), _document(k3=0.01)):
        camera = _build(send(bent), settings).views[0].posed.camera
        np.testing.assert_allclose((camera.fx, camera.fy), (60.0, 61.0))
        assert (camera.cx, camera.cy) != (31.0, 25.0)


def test_file_path_without_extension(send, settings) -> None:
    document = _document()
    document["frames"][0]["file_path"] = "./images/0"
    assert _build(send(document), settings).views[0].posed.name == "images/0.jpg"


def test_untouched_pixels_are_kept_exactly(send, settings) -> None:
    folder = send(_document())
    capture = _build(folder, settings)
    for view, name in zip(capture.views, ("0", "1", "2"), strict=True):
        with Image.open(folder / f"images/{name}.jpg") as image:
            np.testing.assert_array_equal(load_image(view), np.asarray(image.convert("RGB")))


def test_turned_phone_photo_with_given_poses(upload, photo, settings) -> None:
    """Poses are for stored pixels: the view is upright, and a ray still ends on the same colour."""
    exif = Image.Exif()
    exif[0x0112] = 6
    pixels = photo(4, _SIZE, "PNG", exif=exif)
    document = _document(frames=[{"file_path": "a.png", "transform_matrix": np.eye(4).tolist()}])
    view = _build(
        upload({"a.png": pixels, "transforms.json": json.dumps(document).encode(), "points3d.ply": _POINTS}), settings
    ).views[0]
    assert (view.posed.camera.width, view.posed.camera.height) == _SIZE[::-1]
    with Image.open(io.BytesIO(pixels)) as image:
        stored = np.asarray(image)
    upright = load_image(view)
    for u, v in ((5.5, 7.5), (60.5, 40.5), (31.5, 2.5)):
        world = np.array([(u - 31.0) / 60.0, -(v - 25.0) / 61.0, -1.0, 1.0])
        there = view.posed.camera_from_world() @ world
        camera = view.posed.camera
        x, y = camera.fx * there[0] / there[2] + camera.cx, camera.fy * there[1] / there[2] + camera.cy
        np.testing.assert_array_equal(upright[int(y), int(x)], stored[int(v), int(u)])


def test_capture_survives_the_disk(send, settings) -> None:
    masks = {f"masks/{i}.png": _png(np.eye(48, 64, dtype=np.uint8) * 3) for i in range(3)}
    document = _document(labels={"cup": 3}, k1=0.05)
    for i, frame in enumerate(document["frames"]):
        frame["mask_path"] = f"masks/{i}.png"
    folder = send(document, **masks)
    built, loaded = _build(folder, settings), load_capture(folder.parent / "out")
    assert built.report == loaded.report and built.given_labels == loaded.given_labels
    np.testing.assert_array_equal(built.points, loaded.points)
    for one, other in zip(built.views, loaded.views, strict=True):
        assert (one.posed.camera, one.image_path) == (other.posed.camera, other.image_path)
        np.testing.assert_array_equal(one.posed.world_from_camera, other.posed.world_from_camera)
    assert {path.name for path in folder.parent.iterdir()} == {"upload", "out"}
    (moved := folder.parent / "elsewhere").parent.joinpath("out").rename(moved)
    assert load_image(load_capture(moved).views[0]).shape[2] == 3


def test_masks_without_labels_are_ignored_pixels(send, settings) -> None:
    mask = np.zeros((48, 64), np.uint8)
    mask[:, 32:] = 255
    document = _document()
    document["frames"][1]["mask_path"] = "m.png"
    capture = _build(send(document, **{"m.png": _png(mask)}), settings)
    assert capture.given_labels is None and capture.views[0].valid_path is None
    with Image.open(capture.views[1].valid_path) as image:
        np.testing.assert_array_equal(np.asarray(image), mask)
    assert "mask" in capture.report.warnings[0]


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
def test_no_pose(pose: Any, send, settings, refused) -> None:
    document = _document()
    document["frames"][1]["transform_matrix"] = pose
    folder = send(document)
    with refused(InvalidInputError, "transforms.json", "images/1.jpg"):
        admit_upload(folder, settings)


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
        (_document(frames=[{"file_path": "images/9.jpg", "transform_matrix": _pose()}]), "images/9.jpg"),
        (_document(frames=[{"file_path": "../../../../etc/passwd", "transform_matrix": _pose()}]), "passwd"),
        (_document(frames=[{"file_path": "images/0.jpg", "transform_matrix": _pose()}] * 2), "same file"),
        (_document(split={"test": ["7"]}), "'7'"),
        (_document(ply_file_path="lost.ply"), "lost.ply"),
        (_document(labels={"mug": 0.5}), "mug"),
    ],
    ids=lambda value: str(value)[:50],
)
def test_document_that_is_none(document: Any, said: str, send, settings, refused) -> None:
    folder = send(document)
    with refused(InvalidInputError, said):
        admit_upload(folder, settings)


def test_document_that_is_too_large(send, settings, refused) -> None:
    folder = send(_document())
    with refused(LimitExceededError, "transforms.json", "MAX_JSON_BYTES"):
        admit_upload(folder, settings.model_copy(update={"max_json_bytes": 100}))


def _ply(
    form: str, rows: int, body: bytes, properties: str = "float x,float y,float z,uchar red,uchar green,uchar blue"
) -> bytes:
    lines = "".join(f"property {one}\n" for one in properties.split(","))
    return f"ply\nformat {form} 1.0\nelement vertex {rows}\n{lines}end_header\n".encode() + body


def test_ply_forms_say_the_same(tmp_path: Path, settings) -> None:
    xyz = np.array([[0, 0.5, 1], [-1, 2, 3]], np.float32)
    rgb = np.array([[1, 2, 3], [255, 0, 7]], np.uint8)
    text = "".join(" ".join(map(str, [*p.tolist(), *c.tolist()])) + "\n" for p, c in zip(xyz, rgb, strict=True))
    binary = {
        order: b"".join(p.astype(f"{order}f4").tobytes() + c.tobytes() for p, c in zip(xyz, rgb, strict=True))
        for order in "<>"
    }
    bodies = {"ascii": text.encode(), "binary_little_endian": binary["<"], "binary_big_endian": binary[">"]}
    for form, body in bodies.items():
        (tmp_path / "p.ply").write_bytes(_ply(form, 2, body))
        points, colors = read_points(tmp_path / "p.ply", "p.ply", settings)
        np.testing.assert_array_equal(points, xyz)
        np.testing.assert_array_equal(colors, rgb)


@pytest.mark.parametrize(
    ("content", "kind"),
    [
        (_ply("ascii", 10**12, b"0 0 0 1 1 1\n"), LimitExceededError),
        (_ply("ascii", 10**6, b"0 0 0 1 1 1\n"), InvalidInputError),
        (_ply("ascii", 10**30, b""), InvalidInputError),
        (_ply("binary_little_endian", 10**6, bytes(15)), InvalidInputError),
        (_ply("ascii", 1, b"0 0 nan 1 1 1\n"), InvalidInputError),
        (_ply("ascii", 1, b"0 0 zero 1 1 1\n"), InvalidInputError),
        (_ply("ascii", 2, b"0 0 0 1 1 1\n" + b" " * 40), InvalidInputError),
        (_ply("ascii", 1, b"0 0\n", "float x,float y"), InvalidInputError),
        (_ply("ascii", 1, b"0 0\n", "list uchar int x"), InvalidInputError),
        (b"ply\nformat ascii 1.0\n", InvalidInputError),
        (b"ply" + b"\n" * 10**6, InvalidInputError),
        (b"not a ply", InvalidInputError),
        (b"", InvalidInputError),
    ],
)
def test_ply_that_is_none(content: bytes, kind: type[FastSplatError], send, settings, refused) -> None:
    folder = send(_document(), **{"points3d.ply": content})
    with refused(kind, "points3d.ply"):
        admit_upload(folder, settings)
