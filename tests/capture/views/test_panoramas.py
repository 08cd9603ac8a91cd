"""360° panoramas and videos: as rigs of pinhole faces they find their places; what metadata say is not trusted."""

from __future__ import annotations

import json
import struct
from contextlib import suppress
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import ExifTags, Image

from fastsplat.service.capture.build import build_capture, load_image
from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.captures import Capture
from fastsplat.service.capture.formats.upload_manifest import read_manifest
from fastsplat.service.capture.photos.lens_faces import FACES, face_camera, face_rays
from fastsplat.service.capture.photos.panorama import (
    PanoramaFrame,
    decoded_size,
    face_side,
    frame_of_xmp,
    full_frame,
    nadir_mask,
    panorama_faces,
    wrapped,
)
from fastsplat.service.capture.photos.spherical_video import is_spherical
from fastsplat.service.capture.photos.withholding import WithheldPixels
from fastsplat.service.capture.sfm.sfm_images import frame_width, source_ids, upright_photos, video_frames
from fastsplat.service.capture.untrusted.image_decoder import ImageDecoder
from fastsplat.service.capture.untrusted.sandbox import run_sandboxed
from fastsplat.service.capture.uploads.upload_validation import validate_upload
from fastsplat.service.common.progress import silent
from fastsplat_contract.errors import InvalidInputError, LimitExceededError
from tests.capture import made_room
from tests.capture.upload_files import captured, encoded, valid_pixels, video_file

_WIDTH = 640
_PLACES = {
    "a.jpg": made_room.pose((-0.6, 0.3, 1.4), 20),
    "b.jpg": made_room.pose((0.5, -0.5, 1.5), 110),
    "c.jpg": made_room.pose((0.3, 0.7, 1.2), 250),
}
_XMP = b"""<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:Description GPano:ProjectionType="equirectangular"/></x:xmpmeta>"""


@pytest.fixture(scope="module")
def room(tmp_path_factory) -> Capture:
    """The made room from three panoramas that say what they are, 25° around the photographer left out."""
    folder = tmp_path_factory.mktemp("panoramas") / "upload"
    folder.mkdir()
    rays = made_room.panorama_rays(_WIDTH)
    for name, pose in _PLACES.items():
        (folder / name).write_bytes(
            encoded(made_room.photo(pose, rays), "JPEG", quality=95, xmp=_XMP, exif=_somewhere())
        )
    return captured(folder, CaptureSettings(sfm_threads=2, sfm_features=700, nadir_deg=25))


def _somewhere() -> Image.Exif:
    exif = Image.Exif()
    exif.get_ifd(ExifTags.IFD.GPSInfo).update({1: "N", 2: (47.0, 12.0, 34.5), 3: "E", 4: (8.0, 56.0, 7.8), 31: 4.0})
    return exif


def _pose(capture: Capture, name: str) -> np.ndarray:
    return next(view.posed.world_from_camera for view in capture.views if view.posed.name == name)


def test_panoramas_find_their_places(room: Capture) -> None:
    names = sorted(_PLACES)
    estimated = np.array([_pose(room, f"{Path(name).stem}.front.jpg") for name in names])
    truth = np.array([_PLACES[name] for name in names])
    rotation = truth[0, :3, :3] @ estimated[0, :3, :3].T
    for pose, true_pose in zip(estimated, truth, strict=True):
        error = true_pose[:3, :3].T @ rotation @ pose[:3, :3]
        assert np.degrees(np.arccos(np.clip((np.trace(error) - 1) / 2, -1, 1))) < 0.2
    moved, true = estimated[1:, :3, 3] - estimated[0, :3, 3], truth[1:, :3, 3] - truth[0, :3, 3]
    scale = np.linalg.norm(true) / np.linalg.norm(moved)
    np.testing.assert_allclose(scale * moved @ rotation.T, true, atol=0.01)
    assert rotation[2, 2] > np.cos(np.radians(0.3)), "z is up"
    assert room.report.mean_reprojection_error_px < 0.6 and len(room.points) > 300


def test_faces_share_a_place_and_keep_their_rotations(room: Capture) -> None:
    front = _pose(room, "b.front.jpg")
    for face, rotation in FACES.items():
        pose = _pose(room, f"b.{face}.jpg")
        np.testing.assert_allclose(pose[:3, 3], front[:3, 3], atol=1e-9)
        np.testing.assert_allclose(front[:3, :3].T @ pose[:3, :3], rotation, atol=1e-9)


def test_views_show_the_room_as_pinholes(room: Capture) -> None:
    for view in room.views[:6]:
        name, face = view.posed.name.removesuffix(".jpg").split(".")
        pose = _PLACES[f"{name}.jpg"].copy()
        pose[:3, :3] = pose[:3, :3] @ FACES[face]
        made_room.check_picture(load_image(view), valid_pixels(view), view.posed.camera, pose)


def test_the_photographer_is_left_out(room: Capture) -> None:
    masked = {view.posed.name for view in room.views if view.valid_path is not None}
    assert masked == {"a.down.jpg", "b.down.jpg", "c.down.jpg"}
    down = next(view for view in room.views if view.posed.name == "a.down.jpg")
    side = down.posed.camera.width
    inside = np.hypot(*(np.indices((side, side)) + 0.5 - side / 2)) < down.posed.camera.fx * np.tan(np.radians(25))
    valid = valid_pixels(down)
    assert (valid == ~inside).mean() > 0.99
    assert load_image(down)[~valid].max() < 40, "nor is it stored"


def test_verdicts_name_the_panorama_and_its_face(room: Capture) -> None:
    assert room.report.images == 18
    assert {photo.name for photo in room.report.photos} == {f"{name}.{face}.jpg" for name in "abc" for face in FACES}
    assert all(photo.placed and not photo.defects for photo in room.report.photos)


def test_what_is_up_is_said_with_how_sure_that_is(room: Capture) -> None:
    vertical = room.report.vertical
    assert vertical is not None and vertical.source in ("horizon", "planes") and vertical.deviation_deg < 1.5


def test_places_leave_nothing_but_a_reason(room: Capture) -> None:
    """Three photos of a room tell no scale by GPS, and where it is stands in no file of the capture."""
    assert room.scale == "ARBITRARY" and any("GPS places of 3 photos" in warning for warning in room.report.warnings)
    folder = room.views[0].image_path.parent.parent
    for path in folder.rglob("*"):
        if path.is_file():
            assert b"47.209" not in path.read_bytes()  # 47° 12' 34.5"
            assert path.suffix not in (".jpg", ".png") or not Image.open(path).getexif(), path


def test_the_seam_behind_the_photographer_does_not_show() -> None:
    pixels = made_room.photo(_PLACES["a.jpg"], made_room.panorama_rays(512))
    frame = full_frame("x", 512, 256)
    back = next(face for face in panorama_faces(frame, (512, 256), 128) if face.name == "back")
    picture = back.undistortion.apply(wrapped(pixels, frame)).astype(float)
    expected = made_room.photo(_PLACES["a.jpg"], face_rays(face_camera(128)) @ FACES["back"].T).astype(float)
    assert np.abs(picture - expected)[:, 62:66].mean() < 1.5 * np.abs(picture - expected).mean()
    assert back.undistortion.valid(514, 258) is None


def test_a_partial_panorama_shows_what_it_has() -> None:
    xmp = b"""<GPano:ProjectionType>equirectangular</GPano:ProjectionType>
      <GPano:FullPanoWidthPixels>1024</GPano:FullPanoWidthPixels>
      <GPano:FullPanoHeightPixels>512</GPano:FullPanoHeightPixels>
      <GPano:CroppedAreaImageWidthPixels>512</GPano:CroppedAreaImageWidthPixels>
      <GPano:CroppedAreaLeftPixels>256</GPano:CroppedAreaLeftPixels>
      <GPano:CroppedAreaTopPixels>128</GPano:CroppedAreaTopPixels>"""
    frame = frame_of_xmp(xmp, 256, 128)  # the picture was halved since
    assert frame == PanoramaFrame(512, 256, 128, 64, 256, 128) and not frame.around
    whole = made_room.photo(_PLACES["a.jpg"], made_room.panorama_rays(512))
    part = whole[64:192, 128:384]
    undistortions = {face.name: face.undistortion for face in panorama_faces(frame, (256, 128), 96)}
    valid = undistortions["front"].valid(258, 130)
    assert valid is not None and 0.6 < valid.mean() < 1 and "back" not in undistortions
    full = full_frame("x", 512, 256)
    expected = next(iter(panorama_faces(full, (512, 256), 96))).undistortion.apply(wrapped(whole, full))
    inner = cv2.erode(valid.astype(np.uint8), np.ones((5, 5))) > 0
    difference = undistortions["front"].apply(wrapped(part, frame))[inner].astype(int) - expected[inner]
    assert np.abs(difference).max() <= 1, "but for rounding"


def test_up_follows_the_pose_in_the_metadata() -> None:
    """A camera that looks up and is turned clockwise sees the vertical where its own pose puts it."""
    for pitch, roll in ((0, 0), (20, 0), (0, 30), (-15, 40)):
        xmp = _XMP + f'GPano:PosePitchDegrees="{pitch}" GPano:PoseRollDegrees="{roll}"'.encode()
        frame = frame_of_xmp(xmp, 512, 256)
        assert frame is not None and frame.vertical is not None
        rotation = made_room.pose((0, 0, 0), 70, pitch, roll)[:3, :3]
        np.testing.assert_allclose(rotation @ frame.vertical, [0, 0, 1], atol=1e-12)


@pytest.mark.parametrize(
    "xmp",
    [
        b"",
        b'GPano:ProjectionType="cylindrical"',
        _XMP.replace(b"equirectangular", b"e" * 100_000),
        b"\xff\xfe" * 70_000 + _XMP,
        _XMP + b'GPano:FullPanoWidthPixels="1e308" GPano:FullPanoHeightPixels="4" GPano:CroppedAreaLeftPixels="0" '
        b'GPano:CroppedAreaTopPixels="0"',
        _XMP + b'GPano:FullPanoWidthPixels="1024" GPano:FullPanoHeightPixels="512" GPano:CroppedAreaLeftPixels="-900" '
        b'GPano:CroppedAreaTopPixels="0"',
        _XMP + b'GPano:FullPanoWidthPixels="800000" GPano:FullPanoHeightPixels="400000" GPano:CroppedAreaLeftPixels='
        b'"0" GPano:CroppedAreaTopPixels="0" GPano:CroppedAreaImageWidthPixels="1e-9"',
    ],
)
def test_metadata_that_cannot_be_make_no_panorama(xmp: bytes) -> None:
    assert frame_of_xmp(xmp, 512, 256) is None
    assert frame_of_xmp(_XMP, 512, 300) is None, "not twice as wide as high"


def test_what_is_no_panorama_is_refused_as_one(upload, photo, settings, refused) -> None:
    folder = upload({"a.jpg": photo(0), "b.jpg": photo(1)})
    settings = settings.model_copy(update={"lens": "panorama"})
    validate_upload(folder, settings)
    with refused(InvalidInputError, "a.jpg", "twice as wide", "2:1"):
        build_capture(folder, folder.parent / "out", settings, silent)


def test_faces_are_bounded(upload, photo, settings, refused) -> None:
    folder = upload({f"{index}.jpg": photo(index, (256, 128), xmp=_XMP) for index in range(3)})
    settings = settings.model_copy(update={"max_images": 17})
    validate_upload(folder, settings)
    with refused(LimitExceededError, "18 faces", "MAX_IMAGES"):
        build_capture(folder, folder.parent / "out", settings, silent)
    large = full_frame("x", 16_384, 8_192)
    side = face_side(large, CaptureSettings().panorama_face_side)
    assert side == 1024 and decoded_size(large, side)[0] < 3_000, "memory is bounded by the faces"


def test_names_of_faces_are_nobody_elses(upload, photo, settings, refused) -> None:
    folder = upload({"a.jpg": photo(0, (256, 128), xmp=_XMP), "a.left.jpg": photo(1)})
    validate_upload(folder, settings)
    with refused(InvalidInputError, "a.left.jpg"):
        build_capture(folder, folder.parent / "out", settings, silent)


def _octants(rays: np.ndarray) -> np.ndarray:
    """uint8 [H, W], 1 to 8: to which side of a panorama's frame directions [H, W, 3] point along each axis."""
    return ((rays > 0) @ np.array([1, 2, 4]) + 1).astype(np.uint8)


def test_labels_are_cut_as_the_picture_is(upload, settings, tmp_path: Path) -> None:
    rays, files = made_room.panorama_rays(256), {"labels.json": json.dumps([f"part {i}" for i in range(8)]).encode()}
    for name, pose in _PLACES.items():
        files[name] = encoded(made_room.photo(pose, rays), "JPEG", quality=95, xmp=_XMP)
        files[f"labels/{Path(name).stem}.png"] = encoded(_octants(rays))
    folder = upload(files)
    validate_upload(folder, settings)
    images, decoding = tmp_path / "images", tmp_path / "decoding"
    images.mkdir(), decoding.mkdir()
    manifest, sent = read_manifest(folder)
    with ImageDecoder(decoding, (sent, images), settings) as decoder:
        faces = list(
            upright_photos(manifest, sent, images, settings, decoder, WithheldPixels(None, tmp_path / "masks"), {})
        )
        ids = [source_ids(face, sent, manifest.label_maps[face.photo.path], decoder) for face in faces]
    assert [image.file for image in faces[:2]] == ["front/00000.png", "right/00000.png"]
    assert {image.camera_group for image in faces} == set(FACES)
    assert len({(image.width, image.height) for image in faces}) == 1, "one rig has one size of faces"
    for image, id_map in zip(faces, ids, strict=True):
        truth = _octants(face_rays(face_camera(image.width)) @ FACES[image.camera_group].T)
        assert id_map.shape == truth.shape and set(np.unique(id_map)) == set(np.unique(truth))
        # A pixel of the map is one or two of a face's: it may be off at the borders of the parts, and nowhere else.
        inner = cv2.erode(truth, np.ones((5, 5))) == cv2.dilate(truth, np.ones((5, 5)))
        np.testing.assert_array_equal(id_map[inner], truth[inner])
        assert inner.mean() > 0.8


def test_frames_of_a_video_become_faces(tmp_path: Path, settings) -> None:
    settings = settings.model_copy(update={"lens": "panorama", "panorama_frames": 3, "panorama_face_side": 96})
    images = tmp_path / "images"
    for folder in (images, tmp_path / "frames", tmp_path / "decoding"):
        folder.mkdir()
    path = tmp_path / "walk.avi"
    poses = [made_room.pose((0.1 * index, 0, 1.4), 0) for index in range(6)]
    video_file(path, [made_room.photo(pose, made_room.panorama_rays(512)) for pose in poses])
    request = {"video": str(path), "name": "walk.avi", "folder": str(images), **settings.model_dump()}
    request |= {"video_frames": settings.panorama_frames, "max_side": frame_width(settings), "by_place": False}
    result = run_sandboxed("frames", request, tmp_path / "frames", settings, lambda fraction, message: None)
    with ImageDecoder(tmp_path / "decoding", (images,), settings) as decoder:
        rest = ("walk.avi", images, settings, decoder, WithheldPixels(None, tmp_path / "masks"))
        faces = list(video_frames(result["files"], tuple(result["size"]), *rest))
        assert len(faces) == 18 and faces[0].name == f"{Path(result['files'][0]).stem}.front.png"
        assert {image.width for image in faces} == {96 if frame_width(settings) < 512 else faces[0].width}
        with pytest.raises(InvalidInputError, match="twice as wide"):
            list(video_frames(result["files"], (320, 240), *rest))


def test_straight_down_is_masked_in_the_down_face_alone() -> None:
    masks = {face: nadir_mask(64, face, 25) for face in FACES}
    assert [face for face, mask in masks.items() if mask is not None] == ["down"]
    wide = {face: nadir_mask(64, face, 60) for face in FACES}
    assert [face for face, mask in wide.items() if mask is not None] == ["front", "right", "back", "left", "down"]
    assert nadir_mask(64, "down", 0) is None


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
