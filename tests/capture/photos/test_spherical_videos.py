"""360° videos are known by their metadata, in both versions; other spheres are refused, and hostile boxes harmless."""

from __future__ import annotations

import struct
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from fastsplat.service.capture.build import build_capture
from fastsplat.service.capture.formats.upload_manifest import read_manifest
from fastsplat.service.capture.photos.spherical_video import is_spherical
from fastsplat.service.capture.uploads.upload_validation import validate_upload
from fastsplat.service.common.progress import silent
from fastsplat_contract.errors import InvalidInputError, LimitExceededError
from tests.capture.upload_files import video_file

_TRACK = (b"moov", b"trak")
_ENTRY = (*_TRACK, b"mdia", b"minf", b"stbl", b"stsd", b"mp4v")
_BEFORE = {b"stsd": 8, b"mp4v": 78}


def _box(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I4s", 8 + len(content), kind) + content


def _xml(*properties: str, projection: str = "equirectangular") -> bytes:
    text = f"<GSpherical:Spherical>true</GSpherical:Spherical><GSpherical:ProjectionType>{projection}</GSpherical:x>"
    return _box(b"uuid", bytes.fromhex("ffcc8263f8554a938814587a02521fdd") + (text + "".join(properties)).encode())


def _sv3d(projection: bytes = b"equi", bounds: tuple[int, int, int, int] = (0, 0, 0, 0)) -> bytes:
    bounds_box = _box(projection, bytes(4) + struct.pack(">4I", *bounds))
    return _box(b"sv3d", _box(b"svhd", bytes(4) + b"maker\0") + _box(b"proj", _box(b"prhd", bytes(16)) + bounds_box))


def _st3d(mode: int) -> bytes:
    return _box(b"st3d", bytes(4) + bytes([mode]))


def _with(movie: bytes, path: tuple[bytes, ...], box: bytes) -> bytes:
    """The movie with a box at the end of the first one of a path; what lies before stays where it is."""
    start = 0
    while start < len(movie):
        size, kind = struct.unpack_from(">I4s", movie, start)
        if kind == path[0]:
            content, before = movie[start + 8 : start + size], _BEFORE.get(kind, 0)
            inner = content[before:]
            inner = _with(inner, path[1:], box) if path[1:] else inner + box
            return movie[:start] + _box(kind, content[:before] + inner) + movie[start + size :]
        start += size
    raise AssertionError(path)


@pytest.fixture(scope="module")
def movie(tmp_path_factory) -> bytes:
    """Four frames of 256×128, its index behind its pictures."""
    frames = np.random.default_rng(0).integers(0, 256, (4, 128, 256, 3), dtype=np.uint8)
    content = video_file(tmp_path_factory.mktemp("movie") / "walk.mp4", frames, "mp4v")
    assert content.index(b"mdat") < content.index(b"moov")
    return content


@pytest.mark.parametrize(
    ("path", "box"),
    [(_TRACK, _xml()), (_TRACK, _xml('GSpherical:StereoMode="mono"')), (_ENTRY, _st3d(0) + _sv3d())],
    ids=["version 1", "one eye", "version 2"],
)
def test_a_360_video_needs_no_option(movie, upload, settings, refused, path: tuple[bytes, ...], box: bytes) -> None:
    folder = upload({"walk.mp4": _with(movie, path, box)})
    assert read_manifest(validate_upload(folder, settings).folder)[0].spherical
    few = settings.model_copy(update={"max_images": 11, "panorama_frames": 2})
    with refused(LimitExceededError, "12 faces"):
        build_capture(folder, folder.parent / "out", few, silent)


def test_other_videos_are_none(movie, upload, settings) -> None:
    plain = read_manifest(validate_upload(upload({"walk.mp4": movie}), settings).folder)[0]
    assert plain.source == "video" and not plain.spherical
    unsaid = _with(movie, _TRACK, _xml().replace(b"true", b"false"))
    assert not read_manifest(validate_upload(upload({"walk.mp4": unsaid}), settings).folder)[0].spherical


@pytest.mark.parametrize(
    ("path", "box", "words"),
    [
        (_TRACK, _xml("<GSpherical:StereoMode>top-bottom</GSpherical:StereoMode>"), "two eyes"),
        (_TRACK, _xml(projection="cubemap"), "another projection"),
        (
            _TRACK,
            _xml('GSpherical:CroppedAreaImageWidthPixels="128"', ' GSpherical:FullPanoWidthPixels="256"'),
            "a part",
        ),
        (_ENTRY, _st3d(2) + _sv3d(), "two eyes"),
        (_ENTRY, _sv3d(b"cbmp"), "another projection"),
        (_ENTRY, _sv3d(bounds=(0, 0, 1 << 30, 1 << 30)), "a part"),
    ],
)
def test_other_spheres_are_refused(movie, path: tuple[bytes, ...], box: bytes, words: str, refuses) -> None:
    refuses({"walk.mp4": _with(movie, path, box)}, InvalidInputError, "walk.mp4", words)


def test_a_sphere_is_twice_as_wide_as_high(tmp_path: Path, refuses) -> None:
    tall = video_file(tmp_path / "tall.mp4", np.zeros((3, 128, 128, 3), np.uint8), "mp4v")
    refuses({"tall.mp4": _with(tall, _TRACK, _xml())}, InvalidInputError, "tall.mp4", "twice as wide")


_DEEP = b"".join(struct.pack(">I4s", 0, kind) for kind in (*_TRACK, b"mdia", b"minf", b"stbl", b"stsd") * 50)


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\0\0\0\x07moov",
        struct.pack(">I4sQ", 1, b"moov", 1 << 63) + bytes(40),
        struct.pack(">I4sQ", 1, b"moov", 3) + bytes(40),
        struct.pack(">I4s", 1, b"moov"),
        _box(b"moov", _box(b"trak", _box(b"uuid", b"\xff\xcc"))),
        _box(b"moov", _box(b"trak", _xml()[:60])),
        _box(b"moov", _box(b"trak", b"") * 40_000 + _box(b"trak", _xml())),
        _DEEP,
    ],
)
def test_boxes_that_cannot_be_say_nothing(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.mp4").write_bytes(content)
    assert not is_spherical(tmp_path / "a.mp4", "a.mp4")


def test_damaged_boxes_raise_nothing_else(tmp_path: Path, movie) -> None:
    content = bytearray(_with(_with(movie, _ENTRY, _st3d(0) + _sv3d()), _TRACK, _xml()))
    begin = content.index(b"moov") - 4
    rng = np.random.default_rng(0)
    for _ in range(200):
        damaged = bytearray(content)
        for at in rng.integers(begin, len(content), 4):
            damaged[at] = rng.integers(256)
        (tmp_path / "a.mp4").write_bytes(damaged[: rng.integers(begin, len(content))])
        with suppress(InvalidInputError):
            is_spherical(tmp_path / "a.mp4", "a.mp4")
