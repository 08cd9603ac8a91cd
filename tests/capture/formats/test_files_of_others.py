"""Files as other programs write them: each is read as it was meant, or named with what to do."""

from __future__ import annotations

import gzip
import json
import unicodedata
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from fastsplat.service.capture.captures import ValidatedUpload
from fastsplat.service.capture.uploads.splat_input import load_splat
from fastsplat.service.capture.uploads.upload_validation import validate_upload
from fastsplat.service.scene.formats.sog_writing import sog_bytes
from fastsplat.service.scene.formats.zips import zipped
from fastsplat_contract.errors import CorruptImageError, InvalidInputError
from tests.capture.splat_writers import columns_of, write_table
from tests.capture.upload_files import PINHOLE, captured, encoded, frames_of, photo_file, points_file
from tests.scene.conftest import make_gaussians

_PHOTOS = {f"images/{i}.jpg": photo_file(i) for i in range(3)}
_POINTS = points_file((0, 0, 1), (1, 2, 3))
_CAMERAS = b"1 PINHOLE 64 48 60 60 32 24\n"
_GRAY = np.full((48, 64), 255, np.uint8)


def _transforms(names: list[str], frame: dict[str, Any] | None = None, **top: Any) -> bytes:
    frames = [entry | (frame or {}) for entry in frames_of(names)]
    return json.dumps(PINHOLE | {"frames": frames} | top).encode()


def _images(*names: str, between: str = "\n") -> bytes:
    return "".join(f"{i + 1} 1 0 0 0 {i / 10} 0 3 1 {name}\n{between}" for i, name in enumerate(names)).encode()


def _model(*names: str, cameras: bytes = _CAMERAS, folder: str = "sparse/0", **images: Any) -> dict[str, bytes]:
    points = {f"{folder}/points3D.txt": b"1 0 0 1 9 9 9 0.5\n"}
    return {f"{folder}/cameras.txt": cameras, f"{folder}/images.txt": _images(*names, **images), **points}


@pytest.fixture
def validated(upload, settings) -> Callable[..., ValidatedUpload]:
    return lambda files, strict=True: validate_upload(upload(files), settings, strict)


@pytest.mark.parametrize(
    ("there", "name", "how"),
    [
        ("images/left/a.jpg", "images\\left\\a.jpg", "backslashes"),
        ("images/a.JPG", "images/a.jpg", "letter case"),
        (unicodedata.normalize("NFD", "images/ä.jpg"), "images/ä.jpg", "Unicode"),
        ("images/a.jpg", "/home/me/data/images/a.jpg", "folders"),
        ("images/a.jpg", "C:\\data\\A.jpg", "folders"),
        ("input/left/a.jpg", "a.jpg", "folders"),
    ],
)
@pytest.mark.parametrize("posed", ["transforms", "colmap"])
def test_a_name_that_can_mean_one_file_alone_means_it(there: str, name: str, how: str, posed: str, validated) -> None:
    if posed == "transforms":
        document = {"transforms.json": _transforms([name])}
    else:  # whose names are relative to the folder of images
        name = name[7:] if name.startswith("images") else name
        document = _model(name, folder="{x}")
    files = {"masks/a.jpg": b"", "b.jpg": photo_file(5)}
    (warning,) = [text for text in validated({there: photo_file(1), **document, **files}).warnings if how in text]
    assert name in warning and there in warning


def test_a_name_that_can_mean_two_files_means_none(validated) -> None:
    for files in ({"transforms.json": _transforms(["a.jpg"])}, _model("a.jpg")):
        with pytest.raises(InvalidInputError, match=r"a\.jpg"):
            validated({"one/a.jpg": photo_file(1), "two/a.jpg": photo_file(2), **files})


def test_documents_of_a_split_are_one_capture(upload, settings) -> None:
    """Blender's layout: each document has its own angle, file paths have no extension, and stems repeat."""
    files = {"points3d.ply": _POINTS}
    files |= {f"{part}/r_{i}.png": photo_file(i, form="PNG") for part in ("train", "val", "test") for i in range(2)}
    for part, angle in (("train", 0.6), ("val", 0.7), ("test", 0.8)):
        frames = frames_of(f"./{part}/r_{i}" for i in range(2))
        files[f"transforms_{part}.json"] = json.dumps({"camera_angle_x": angle, "frames": frames}).encode()
    capture = captured(upload(files), settings)
    assert capture.report.source == "nerfstudio" and capture.test_names == ("test/r_0.png", "test/r_1.png")
    focals = [view.posed.camera.fx for view in capture.views]
    np.testing.assert_allclose(focals, np.repeat([32 / np.tan(a / 2) for a in (0.8, 0.6, 0.7)], 2))


@pytest.mark.parametrize("name", ["cameras.xml", "bundle.out", "poses.csv", "cameras.json", "notes.txt"])
def test_what_lies_beside_photos_and_is_not_read_is_named(name: str, validated, tmp_path: Path) -> None:
    splat = {"a.ply": _table(tmp_path / "own.ply")}
    for posed in ({}, splat, {"transforms.json": _transforms([*_PHOTOS])}, _model("0.jpg", "1.jpg")):
        (tmp_path / "place" / "upload" / "a.ply").unlink(missing_ok=True)
        warnings = validated({**_PHOTOS, **posed, name: b"{}"}).warnings
        assert any(name in text for text in warnings) == (posed in ({}, splat) or name != "notes.txt")
        assert any("images/1.jpg" in text for text in warnings) == (posed == splat)


def test_colmap_masks_and_transparent_pixels_have_no_loss(upload, settings) -> None:
    mask, rgba = _GRAY.copy(), np.full((48, 64, 4), 200, np.uint8)
    mask[:, :20], rgba[:24, :, 3] = 0, 0
    masks = {"masks/0.jpg.png": encoded(np.repeat(mask[..., None], 3, axis=2)), "images/3.png": encoded(rgba)}
    capture = captured(upload({**_PHOTOS, **_model("0.jpg", "1.jpg", "3.png"), **masks}), settings)
    valid = [view.valid_path and np.asarray(Image.open(view.valid_path)) > 0 for view in capture.views]
    np.testing.assert_array_equal(valid[0], mask > 0)
    assert valid[1] is None
    np.testing.assert_array_equal(valid[2], rgba[..., 3] > 0)
    said = " ".join(capture.report.warnings)
    assert "1 images have a mask" in said and "1 of the photos have transparent pixels" in said


def test_text_models_as_other_programs_write_them(upload, settings) -> None:
    """A byte order mark, sizes as floats, blanks in names, and no line of observations behind an image."""
    names = ["0.jpg", "b  c.jpg", "1.jpg", "2.jpg"]
    for between in ("", "\n", "1.5 2.5 -1\n", "1 2 3 4 5 6 7 8 9 10 11 -1\n"):
        files = _model(*names, cameras=b"\xef\xbb\xbf1 PINHOLE 64.0 48.0 60 60 32 24\n", between=between)
        folder = upload({**_PHOTOS, "images/b  c.jpg": photo_file(9), **files})
        assert validate_upload(folder, settings, strict=True).images == 4


def test_of_two_models_the_one_with_most_images_is_read(validated) -> None:
    models = _model("0.jpg") | _model("0.jpg", "1.jpg", "2.jpg", folder="sparse/1")
    read = validated({**_PHOTOS, **models})
    assert read.images == 3 and "only sparse/1 is used" in read.warnings[0]


@pytest.mark.parametrize(
    ("frame", "top", "focal"),
    [
        ({"fl_x": None, "w": None}, {}, 60),
        ({"camera_angle_x": 1.0}, {"fl_y": None}, 32 / np.tan(0.5)),
        ({"fl_x": 70.0, "fl_y": None}, {"fl_y": 70, "labels": None, "convention": None, "split": None}, 70),
    ],
)
def test_null_is_absent_and_a_frame_wins(frame: Any, top: Any, focal: float, upload, settings) -> None:
    files = {**_PHOTOS, "points3d.ply": _POINTS, "transforms.json": _transforms([*_PHOTOS], frame, **top)}
    np.testing.assert_allclose([view.posed.camera.fx for view in captured(upload(files), settings).views], focal)


def _table(path: Path, **changes: np.ndarray | None) -> bytes:
    columns = columns_of(make_gaussians(40, 4, 0)) | changes
    write_table(path, {name: column for name, column in columns.items() if column is not None})
    return path.read_bytes()


def test_splats_of_other_kinds_are_read(validated, tmp_path: Path) -> None:
    """Our own SOG, alone and renamed; a gzip of a PLY; a PLY of the other byte order; flat disks; activated columns."""
    gaussians, plain = make_gaussians(40, 4, 0), _table(tmp_path / "own.ply")
    shares = np.linspace(0.1, 0.9, len(gaussians), dtype=np.float32)
    swapped = plain.partition(b"end_header\n")[2]
    big = plain.replace(b"little", b"big").removesuffix(swapped) + np.frombuffer(swapped, "<f4").astype(">f4").tobytes()
    for name, content, said in (
        ("a.sog", sog_bytes(gaussians), ""),
        ("a.zip", sog_bytes(gaussians), ""),
        ("a.ply.gz", gzip.compress(plain), ""),
        ("a.ply", big, ""),
        ("a.ply", _table(tmp_path / "flat.ply", scale_2=None), "flat"),
        ("a.ply", _table(tmp_path / "opacity.ply", opacity=shares), "opacity of a.ply lies between 0.1 and 0.9"),
        ("a.ply", _table(tmp_path / "scales.ply", **{f"scale_{i}": shares for i in range(3)}), "scale_0"),
    ):
        for old in (tmp_path / "place" / "upload").glob("a.*"):
            old.unlink()
        read = validated({name: content})
        rows = load_splat(read.folder / "splat.safetensors")
        assert (read.source, len(rows)) == ("splat", 40) and said in " ".join(read.warnings)
        if not said:
            order = np.lexsort(rows.means.T), np.lexsort(gaussians.means.T)
            np.testing.assert_allclose(rows.means[order[0]], gaussians.means[order[1]], atol=1e-3)


@pytest.mark.parametrize(
    ("files", "said"),
    [
        ({"a.glb": b"glTF"}, ["a.glb", "glTF"]),
        ({"a.zip": zipped({"inner.zip": zipped(_PHOTOS)})}, ["inner.zip", "archive in the archive"]),
        ({"meta.json": b"{}", "means_l.webp": b"", "means_u.webp": b""}, ["meta.json", "SOG"]),
        ({**_PHOTOS, "transforms.json": _transforms([*_PHOTOS], fl_x="60.5")}, ["fl_x is '60.5'"]),
        (
            {
                **_PHOTOS,
                "d.png": encoded(_GRAY),
                "transforms.json": _transforms([*_PHOTOS], {"depth_file_path": "d.png"}),
            },
            ["d.png", "8 bits"],
        ),
        (
            {"a.tif": encoded(Image.fromarray(np.zeros((48, 64), np.float32)), "TIFF"), "b.jpg": photo_file()},
            ["a.tif", "floating"],
        ),
    ],
)
def test_what_cannot_be_read_is_named_with_a_way(files: dict[str, bytes], said: list[str], refuses) -> None:
    refuses(files, InvalidInputError if "a.tif" not in files else CorruptImageError, *said, strict=True)
