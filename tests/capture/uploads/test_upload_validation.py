"""Uploads as a whole: their kind, their label maps, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from fastsplat.service.capture.build import build_capture
from fastsplat.service.capture.formats.capture_files import load_capture
from fastsplat.service.capture.formats.image_io import check_image, load_upright
from fastsplat.service.capture.formats.upload_manifest import read_manifest
from fastsplat.service.capture.uploads.label_maps import parse_label_table
from fastsplat.service.capture.uploads.upload_validation import validate_upload
from fastsplat.service.common.progress import silent
from fastsplat_contract.errors import CorruptImageError, FastSplatError, InvalidInputError, LimitExceededError
from tests.capture.upload_files import PINHOLE, encoded, frames_of, photo_file, points_file, turned, video_file


def _ids(size: tuple[int, int] = (64, 48), *values: int, dtype: type = np.uint8) -> bytes:
    ids = np.zeros(size[::-1], dtype)
    for row, value in enumerate(values):
        ids[row] = value
    return encoded(ids)


_NOTES = b"these are my holiday notes"
_PHOTOS = {f"{name}.jpg": photo_file(number) for number, name in enumerate("ab")}
_LABELED = _PHOTOS | {"labels.json": b'["mug", "table"]'}
_REFUSED: dict[str, tuple[dict[str, bytes], type[FastSplatError], tuple[str, ...]]] = {
    "nothing": ({}, InvalidInputError, ("no images",)),
    "text": ({"readme.txt": b"hello"}, InvalidInputError, ("no images",)),
    "label maps alone": ({"labels/a.png": _ids()}, InvalidInputError, ("no images",)),
    "one image": ({"a.jpg": photo_file()}, InvalidInputError, ("a.jpg", "at least 2")),
    "one that is none": ({"a.jpg": _NOTES}, CorruptImageError, ("a.jpg", "is not an image")),
    "one that is none, with labels": (
        {"a.jpg": _NOTES, "labels.json": b'["mug"]', "labels/a.png": b""},
        CorruptImageError,
        ("a.jpg", "is not an image"),
    ),
    "formats of phones": (
        {"IMG_1.AVIF": b"\0\0\0\x18ftypavif", "IMG_2.GIF": b"GIF89a"},
        InvalidInputError,
        ("IMG_1.AVIF", "AVIF", "1 other of the upload"),
    ),
    "one usable of four": (
        {"a.jpg": photo_file(), **dict.fromkeys(("b.jpg", "c.jpg", "d.jpg"), b"x")},
        CorruptImageError,
        ("b.jpg", "2 others of the upload"),
    ),
    "an empty video": ({"a.mp4": b""}, InvalidInputError, ("a.mp4",)),
    "a video of text": ({"a.mp4": b"no video"}, InvalidInputError, ("a.mp4",)),
    "a playlist": ({"a.mp4": b"#EXTM3U\nhttp://example.org/a.ts\n"}, InvalidInputError, ("a.mp4",)),
    "the header of a video": ({"a.mp4": b"\0\0\0\x18ftypmp42" + bytes(400)}, InvalidInputError, ("a.mp4",)),
    "two videos": ({"a.mp4": b"x", "b.mp4": b"x"}, InvalidInputError, ("2 videos",)),
    "maps of another size": (
        {**_LABELED, "labels/a.png": _ids((32, 24))},
        InvalidInputError,
        ("labels/a.png", "32×24", "64×48"),
    ),
    "an unknown id": ({**_LABELED, "labels/a.png": _ids((64, 48), 1, 9)}, InvalidInputError, ("labels/a.png", "9")),
    "an unknown id of 16 bits": (
        {**_LABELED, "labels/a.png": _ids((64, 48), 1, 4000, dtype=np.uint16)},
        InvalidInputError,
        ("labels/a.png", "4000"),
    ),
    "a map of no photo": ({**_LABELED, "labels/c.png": _ids()}, InvalidInputError, ("labels/c.png",)),
    "a map that is no image": ({**_LABELED, "labels/a.png": b"text"}, CorruptImageError, ("labels/a.png",)),
    "maps without names": ({**_PHOTOS, "labels/a.png": _ids()}, InvalidInputError, ("labels.json",)),
}


@pytest.mark.parametrize("case", _REFUSED)
def test_what_is_no_upload_is_refused_by_its_file(case: str, refuses) -> None:
    files, kind, said = _REFUSED[case]
    refuses(files, kind, *said)


def test_too_many_images(photo, refuses) -> None:
    refuses({f"{i}.jpg": photo(i) for i in range(5)}, LimitExceededError, "MAX_IMAGES", max_images=4)


def _spoiled(photo) -> dict[str, bytes]:
    """Photos of which each is spoiled in a way of its own; those of the last two are photos nevertheless."""
    rng = np.random.default_rng(2)
    noise = Image.fromarray(rng.integers(0, 256, (48, 64, 3), np.uint8))
    absurd, places = Image.Exif(), Image.Exif()
    absurd.update({0x0112: 77, 0x010F: "x" * 9_000})
    absurd.get_ifd(0x8769).update({0x829A: float("nan"), 0xA405: 65_000, 0x9003: "99:99:99"})
    places.get_ifd(0x8825).update({1: "Q", 2: (999.0, 1e9, 999.0), 6: 4e9})

    flipped = bytearray(encoded(noise))
    flipped[len(flipped) // 2] ^= 0xFF
    return {
        "Zz_bad.jpg": rng.bytes(3_000),
        "cut.JPG": photo(1, (256, 192))[:2_000],
        "cut.png": encoded(noise)[:4_000],
        "flipped.png": bytes(flipped),
        "empty.jpg": b"",
        "notes.jpg": _NOTES,
        "a paper.jpeg": b"%PDF-1.7 " + rng.bytes(500),
        "waving.webp": encoded(noise, "GIF", save_all=True, append_images=[noise.rotate(90)]),
        "waving.gif": encoded(noise, "GIF"),
        "raw.DNG": b"II*\0" + rng.bytes(500),
        "IMG\u202f5.tif": encoded(Image.fromarray(np.full((48, 64), -7, np.int32)), "TIFF"),
        "huge.png": encoded(Image.new("1", (30_000, 30_000)), "PNG"),
        "lab.tif": encoded(noise.convert("LAB"), "TIFF"),
        "absurd.jpg": photo(30, exif=absurd),
        "nowhere.jpg": photo(31, exif=places),
    }


def test_each_photo_that_cannot_be_used_costs_itself_alone(upload, photo, settings) -> None:
    """And is named under its own spelling, once."""
    good = {f"IMG_{number}.jpg": photo(number) for number in range(9)}
    spoiled = _spoiled(photo)
    usable = {*good, "absurd.jpg", "nowhere.jpg"}
    if "lab.tif" not in (validated := validate_upload(upload({**good, **spoiled}), settings)).left_out:
        usable.add("lab.tif")
    assert set(validated.left_out) == {*spoiled} - usable
    manifest, files = read_manifest(validated.folder)
    assert {photo.path for photo in manifest.photos} == usable and manifest.left_out == validated.left_out
    for name, reason in validated.left_out.items():
        assert reason and name.casefold() not in reason.casefold()
    for photo_info in manifest.photos:
        load_upright(files, photo_info, settings)
    for name in sorted(set(spoiled) - usable)[::4]:
        folder = upload({})
        for other_name in set(spoiled) - {name}:
            (folder / other_name).unlink(missing_ok=True)
        (folder / name).write_bytes(spoiled[name])
        with pytest.raises(FastSplatError) as caught:
            validate_upload(folder, settings, strict=True)
        assert name in caught.value.message and caught.value.field == name


def test_a_label_map_that_does_not_fit_costs_its_photo(upload, photo, settings) -> None:
    maps = {"labels/0.png": _ids((32, 24)), "labels/1.png": b"text", "labels/2.png": _ids(), "labels/bad.png": _ids()}
    photos = {f"{number}.jpg": photo(number) for number in range(4)}
    validated = validate_upload(upload({**photos, "bad.jpg": b"x", **maps, "labels.json": b'["mug"]'}), settings)
    assert set(validated.left_out) == {"0.jpg", "1.jpg", "bad.jpg"}
    assert "labels/0.png has 32×24 pixels" in validated.left_out["0.jpg"]
    assert read_manifest(validated.folder)[0].label_maps == {"2.jpg": "labels/2.png"}


@pytest.mark.filterwarnings("ignore::UserWarning:PIL")
def test_what_is_admitted_can_be_decoded(tmp_path: Path, settings) -> None:
    """Whatever bytes of an image were changed: what the check of uploads passes, no later stage refuses."""
    rng = np.random.default_rng(6)
    image = Image.fromarray(rng.integers(0, 256, (24, 32), np.uint8)).convert("P")
    admitted = 0
    for form in ("PNG", "TIFF", "BMP", "JPEG"):
        whole = encoded(image.convert("L"), form)
        for _ in range(150):
            content = np.frombuffer(whole, np.uint8).copy()
            content[rng.integers(0, len(content), 3)] = rng.integers(0, 256, 3)
            (tmp_path / "a.png").write_bytes(content.tobytes())
            try:
                info = check_image(tmp_path, "a.png", settings)
            except FastSplatError:
                continue
            load_upright(tmp_path, info, settings)
            admitted += 1
    assert admitted > 30


def test_link_in_the_upload(upload, settings, refused) -> None:
    folder = upload(_PHOTOS)
    (folder / "c.jpg").symlink_to("/etc/passwd")
    with refused(InvalidInputError, "c.jpg"):
        validate_upload(folder, settings)


def _video(path: Path, frames: int) -> bytes:
    return video_file(path, [np.full((48, 64, 3), 5 * index, np.uint8) for index in range(frames)])


def test_a_video_that_is_too_long_is_refused_before_it_is_acknowledged(upload, settings, refused, tmp_path) -> None:
    """By its frames, whatever its header says of their number."""
    content = _video(tmp_path / "video.avi", 31)
    header = content.index(b"avih") + 8
    lying = bytearray(content)
    lying[header + 16 : header + 20] = (2).to_bytes(4, "little")  # dwTotalFrames
    limited = settings.model_copy(update={"max_video_frames_read": 30})
    for video in (content, bytes(lying)):
        folder = upload({"walk.avi": video})
        with refused(LimitExceededError, "walk.avi", "30 frames", "3 s", " frames"):
            validate_upload(folder, limited)
    assert validate_upload(folder, settings.model_copy(update={"max_video_frames_read": 31})).source == "video"


def test_a_video_of_one_frame_is_refused(tmp_path, refuses) -> None:
    refuses({"walk.avi": _video(tmp_path / "video.avi", 1)}, InvalidInputError, "walk.avi")


def test_reduced_copies_and_masks_are_no_photos(upload, photo, settings) -> None:
    files = {f"{folder}/{i}.jpg": photo(i) for folder in ("images", "images_2", "masks") for i in range(3)}
    assert validate_upload(upload(files), settings).images == 3


def test_validating_twice_gives_the_same(upload, settings) -> None:
    folder = upload({**_PHOTOS, ".validated/validated.json": b"forged"})
    first = validate_upload(folder, settings)
    listing = sorted(folder.rglob("*"))
    assert validate_upload(folder, settings) == first
    assert sorted(folder.rglob("*")) == listing


def test_building_what_was_never_validated_or_over_foreign_files(upload, settings, refused) -> None:
    folder = upload({**_PHOTOS, "validated.json": b'{"source": "images"}'})
    with refused(InvalidInputError, "no validated upload"):
        build_capture(folder, folder.parent / "out", settings, silent)
    validate_upload(folder, settings)
    with refused(InvalidInputError, "in use"):
        build_capture(folder, folder, settings, silent)


@pytest.mark.parametrize("document", [{"labels": {"Mug": 1, "red table": 5}}, {"red table": 5, "Mug": 1, "none": 0}])
def test_label_tables(document: Any) -> None:
    table = parse_label_table(document, field="labels.json")
    assert (table.names, table.ids) == (("Mug", "red table"), (1, 5))
    np.testing.assert_array_equal(table.translate(np.array([[0, 1, 5]], np.uint16)), [[0, 1, 2]])
    assert parse_label_table([*table.names], field="labels.json").ids == (1, 2)


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
def test_malformed_labels(document: Any, said: str, refuses) -> None:
    files = {**_PHOTOS, "labels/a.png": _ids(), "labels.json": json.dumps(document).encode()}
    refuses(files, InvalidInputError, "labels.json", said)


def test_labels_follow_their_image(upload, photo, settings) -> None:
    """Drawn upright for a photo stored on its side; undistorted with it; ids renumbered without gaps."""
    document = {**PINHOLE, "k1": 0.1, "frames": frames_of(["a.jpg", "b.jpg"])}
    top_left = np.zeros((64, 48), np.uint8)
    top_left[:32, :24] = 40
    files = {"a.jpg": photo(1, exif=turned(6)), "b.jpg": photo(2), "points3d.ply": points_file((0, 0, 1))}
    files |= {"transforms.json": json.dumps(document).encode(), "labels.json": b'{"sky": 30, "roof": 40}'}
    folder: Path = upload({**files, "labels/a.png": encoded(top_left)})
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


def test_frames_that_are_excluded_are_left_out_and_named(upload, photo, settings) -> None:
    files = {f"images/{i}.jpg": photo(i) for i in range(3)}
    document = json.dumps({**PINHOLE, "frames": frames_of(files)}).encode()
    folder = upload({**files, "points3d.ply": points_file((0, 0, 1)), "transforms.json": document})
    validate_upload(folder, settings)
    whole = build_capture(folder, folder.parent / "whole", settings, silent)
    capture = build_capture(folder, folder.parent / "out", settings, silent, exclude=("images/1.jpg",))
    assert len(whole.views) == 3 and not whole.report.left_out
    assert [view.posed.name for view in capture.views] == [whole.views[0].posed.name, whole.views[2].posed.name]
    assert load_capture(folder.parent / "out").report.left_out == {"images/1.jpg": "left out on request"}
    assert capture.report.images == 2 and len(capture.report.photos) == 2
