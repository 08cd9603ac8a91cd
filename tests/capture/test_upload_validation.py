"""Uploads as a whole: their kind, their label maps, and what is refused."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from PIL import Image

from fastsplat.service.capture import build_capture, validate_upload
from fastsplat.service.capture.label_maps import parse_label_table
from fastsplat.service.common.progress import silent
from fastsplat_contract.errors import CorruptImageError, InvalidInputError, LimitExceededError


def _ids(size: tuple[int, int] = (64, 48), *values: int, dtype: type = np.uint8) -> bytes:
    ids = np.zeros(size[::-1], dtype)
    for row, value in enumerate(values):
        ids[row] = value
    stream = io.BytesIO()
    Image.fromarray(ids).save(stream, "PNG")
    return stream.getvalue()


@pytest.mark.parametrize("files", [{}, {"readme.txt": b"hello"}, {"labels/a.png": _ids()}])
def test_no_images(files: dict[str, bytes], upload, settings, refused) -> None:
    folder = upload(files)
    with refused(InvalidInputError, "no images"):
        validate_upload(folder, settings)


def test_one_image(upload, photo, settings, refused) -> None:
    folder = upload({"alone.jpg": photo()})
    with refused(InvalidInputError, "alone.jpg", "at least 2"):
        validate_upload(folder, settings)


@pytest.mark.parametrize("files", [{}, {"labels.json": b'["mug"]', "labels/alone.png": b""}])
def test_the_only_image_is_not_an_image(files: dict[str, bytes], upload, settings, refused) -> None:
    folder = upload({"alone.jpg": b"these are my holiday notes", **files})
    with refused(CorruptImageError, "alone.jpg", "is not an image"):
        validate_upload(folder, settings)


def test_too_many_images(upload, photo, settings, refused) -> None:
    folder = upload({f"{i}.jpg": photo(i) for i in range(5)})
    with refused(LimitExceededError, "MAX_IMAGES"):
        validate_upload(folder, settings.model_copy(update={"max_images": 4}))


def test_phone_format(upload, photo, settings, refused) -> None:
    folder = upload({"a.jpg": photo(), "IMG_1.AVIF": b"\0\0\0\x18ftypavif"})
    with refused(InvalidInputError, "IMG_1.AVIF", "AVIF"):
        validate_upload(folder, settings)


def test_link_in_the_upload(upload, photo, settings, refused) -> None:
    folder = upload({"a.jpg": photo(1), "b.jpg": photo(2)})
    (folder / "c.jpg").symlink_to("/etc/passwd")
    with refused(InvalidInputError, "c.jpg"):
        validate_upload(folder, settings)


@pytest.mark.parametrize(
    "content", [b"", b"no video", b"#EXTM3U\nhttp://example.org/a.ts\n", b"\0\0\0\x18ftypmp42" + bytes(400)]
)
def test_no_video(content: bytes, upload, settings, refused) -> None:
    folder = upload({"walk.mp4": content})
    with refused(InvalidInputError, "walk.mp4"):
        validate_upload(folder, settings)


def _video(path: Path, frames: int) -> bytes:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 10, (64, 48))
    for index in range(frames):
        writer.write(np.full((48, 64, 3), 5 * index, np.uint8))
    writer.release()
    content = path.read_bytes()
    path.unlink()
    return content


def test_a_video_that_is_too_long_is_refused_before_it_is_acknowledged(upload, settings, refused, tmp_path) -> None:
    """By its frames, whatever its header says of their number."""
    content = _video(tmp_path / "video.avi", 31)
    header = content.index(b"avih") + 8
    lying = bytearray(content)
    lying[header + 16 : header + 20] = (2).to_bytes(4, "little")  # dwTotalFrames
    limited = settings.model_copy(update={"max_video_frames_read": 30})
    for video in (content, bytes(lying)):
        folder = upload({"walk.avi": video})
        with refused(LimitExceededError, "walk.avi", "30 frames", "3 s", "MAX_VIDEO_FRAMES_READ"):
            validate_upload(folder, limited)
    assert validate_upload(folder, settings.model_copy(update={"max_video_frames_read": 31})).source == "video"


def test_a_video_of_one_frame_is_refused(upload, settings, refused, tmp_path) -> None:
    folder = upload({"walk.avi": _video(tmp_path / "video.avi", 1)})
    with refused(InvalidInputError, "walk.avi"):
        validate_upload(folder, settings)


def test_two_videos(upload, settings, refused) -> None:
    folder = upload({"a.mp4": b"x", "b.mp4": b"x"})
    with refused(InvalidInputError, "2 videos"):
        validate_upload(folder, settings)


def test_reduced_copies_and_masks_are_no_photos(upload, photo, settings) -> None:
    files = {f"{folder}/{i}.jpg": photo(i) for folder in ("images", "images_2", "masks") for i in range(3)}
    assert validate_upload(upload(files), settings).images == 3


def test_validating_twice_gives_the_same(upload, photo, settings) -> None:
    folder = upload({"a.jpg": photo(1), "b.jpg": photo(2), ".admitted/admitted.json": b"forged"})
    first = validate_upload(folder, settings)
    listing = sorted(folder.rglob("*"))
    assert validate_upload(folder, settings) == first
    assert sorted(folder.rglob("*")) == listing


def test_building_what_was_never_validated(upload, photo, settings, refused) -> None:
    folder = upload({"a.jpg": photo(1), "admitted.json": b'{"source": "images"}'})
    with refused(InvalidInputError, "no validated upload"):
        build_capture(folder, folder.parent / "out", settings, silent)


def test_building_over_foreign_files(upload, photo, settings, refused) -> None:
    folder = upload({"a.jpg": photo(1), "b.jpg": photo(2)})
    validate_upload(folder, settings)
    with refused(InvalidInputError, "in use"):
        build_capture(folder, folder, settings, silent)


@pytest.mark.parametrize(
    "document",
    [{"labels": {"Mug": 1, "red table": 5}}, {"red table": 5, "Mug": 1, "background": 0}],
)
def test_label_tables(document: Any) -> None:
    table = parse_label_table(document, field="labels.json")
    assert (table.names, table.ids) == (("Mug", "red table"), (1, 5))
    np.testing.assert_array_equal(table.translate(np.array([[0, 1, 5]], np.uint16)), [[0, 1, 2]])


def test_label_list() -> None:
    assert parse_label_table(["a", "b"], field="labels.json").ids == (1, 2)


@pytest.mark.parametrize(
    ("document", "said"),
    [
        ("mug", "names"),
        ({}, "no labels"),
        ([], "no labels"),
        ({"mug": -1}, "mug"),
        ({"mug": 65536}, "65535"),
        ({"mug": "1"}, "mug"),
        ({"mug": True}, "mug"),
        ({"mug": None}, "mug"),
        ({"mug": [1]}, "mug"),
        ({"mug": 1, "cup": 1}, "share an id"),
        (["mug", "Mugs"], "share a name"),
        ([""], "name"),
        ([7], "7"),
        (["x" * 300], "name"),
    ],
)
def test_malformed_labels(document: Any, said: str, upload, photo, settings, refused) -> None:
    files = {"a.jpg": photo(1), "b.jpg": photo(2), "labels/a.png": _ids()}
    folder = upload({**files, "labels.json": json.dumps(document).encode()})
    with refused(InvalidInputError, "labels.json", said):
        validate_upload(folder, settings)


@pytest.mark.parametrize(
    ("files", "said"),
    [
        ({"labels/a.png": _ids((32, 24))}, ("labels/a.png", "32×24", "64×48")),
        ({"labels/a.png": _ids((64, 48), 1, 2, 9)}, ("labels/a.png", "9")),
        ({"labels/a.png": _ids((64, 48), 1, 4000, dtype=np.uint16)}, ("labels/a.png", "4000")),
        ({"labels/c.png": _ids()}, ("labels/c.png",)),
    ],
)
def test_label_maps_that_do_not_fit(
    files: dict[str, bytes], said: tuple[str, ...], upload, photo, settings, refused
) -> None:
    folder = upload({"a.jpg": photo(1), "b.jpg": photo(2), "labels.json": b'["mug", "table"]', **files})
    with refused(InvalidInputError, *said):
        validate_upload(folder, settings)


def test_label_map_that_is_no_image(upload, photo, settings, refused) -> None:
    folder = upload({"a.jpg": photo(1), "b.jpg": photo(2), "labels.json": b'["mug"]', "labels/a.png": b"text"})
    with refused(CorruptImageError, "labels/a.png"):
        validate_upload(folder, settings)


def test_label_maps_without_names(upload, photo, settings, refused) -> None:
    folder = upload({"a.jpg": photo(1), "b.jpg": photo(2), "labels/a.png": _ids()})
    with refused(InvalidInputError, "labels.json"):
        validate_upload(folder, settings)


def test_labels_follow_their_image(upload, photo, settings) -> None:
    """Drawn upright for a photo stored on its side; undistorted with it; ids renumbered without gaps."""
    exif = Image.Exif()
    exif[0x0112] = 6
    frames = [{"file_path": f"{name}.jpg", "transform_matrix": np.eye(4).tolist()} for name in "ab"]
    document = {"w": 64, "h": 48, "fl_x": 60, "cx": 32, "cy": 24, "k1": 0.1, "frames": frames}
    head = "ply\nformat ascii 1.0\nelement vertex 1\n"
    points = f"{head}property float x\nproperty float y\nproperty float z\nend_header\n0 0 1\n".encode()
    top_left = np.zeros((64, 48), np.uint8)
    top_left[:32, :24] = 40
    stream = io.BytesIO()
    Image.fromarray(top_left).save(stream, "PNG")
    files = {"a.jpg": photo(1, exif=exif), "b.jpg": photo(2), "points3d.ply": points}
    files |= {"transforms.json": json.dumps(document).encode(), "labels.json": b'{"sky": 30, "roof": 40}'}
    folder: Path = upload({**files, "labels/a.png": stream.getvalue()})
    assert validate_upload(folder, settings).has_labels
    capture = build_capture(folder, folder.parent / "out", settings, silent)
    labels = capture.given_labels
    assert labels is not None and labels.map_paths[1] is None and labels.dictionary.id_of("roof") == 2
    with Image.open(labels.map_paths[0]) as image:
        ids = np.asarray(image)
    camera = capture.views[0].posed.camera
    assert ids.shape == (camera.height, camera.width)
    rows, columns = np.nonzero(ids == 2)
    assert set(np.unique(ids)) == {0, 2}
    assert (rows.max() + 1, columns.max() + 1) == pytest.approx((camera.cy, camera.cx), abs=1.0)
