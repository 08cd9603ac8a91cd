"""Photos: orientation, modes, limits; those of iPhones are read like others and checked before they are decoded."""

from __future__ import annotations

import io
import json
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pillow_heif
import pytest
from PIL import ExifTags, Image, ImageOps
from PIL.TiffImagePlugin import IFDRational

from fastsplat.service.capture.build import build_capture, load_image
from fastsplat.service.capture.formats.image_io import check_image, load_upright, read_size
from fastsplat.service.capture.untrusted.sandbox import run_sandboxed
from fastsplat.service.capture.uploads.upload_validation import validate_upload
from fastsplat.service.common.progress import silent
from fastsplat_contract.errors import CorruptImageError, FastSplatError, LimitExceededError
from tests.capture.upload_files import PINHOLE, frames_of, points_file, turned


@pytest.mark.parametrize("orientation", range(1, 9))
def test_orientation_is_applied(orientation: int, tmp_path: Path, settings, photo) -> None:
    (tmp_path / "a.png").write_bytes(photo(3, (40, 24), "PNG", exif=turned(orientation)))
    with Image.open(tmp_path / "a.png") as image:
        expected = np.asarray(ImageOps.exif_transpose(image))
    info = check_image(tmp_path, "a.png", settings)
    pixels = load_upright(tmp_path, info, settings)
    assert info.orientation == orientation
    assert info.upright_size == pixels.shape[1::-1]
    np.testing.assert_array_equal(pixels, expected)
    if not info.mirrored:
        with Image.open(tmp_path / "a.png") as image:
            np.testing.assert_array_equal(np.rot90(np.asarray(image), -info.quarter_turns), expected)


_EXPOSURE = {0x829A: IFDRational(1, 50), 0x829D: IFDRational(2, 1), 0x8827: 200}


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, np.log2(1 / 50 * 200 / 100 / 4)),
        ({0x829A: IFDRational(1, 25)}, np.log2(1 / 25 * 200 / 100 / 4)),
        ({0x9204: IFDRational(1, 1)}, np.log2(1 / 50 * 200 / 100 / 4)),  # a bias is in the others already
        ({0x829D: None}, None),
        ({0x829D: IFDRational(0, 1)}, None),
        ({0x829A: IFDRational(1, 0)}, None),
        ({0x8827: 0}, None),
        ({0x829A: "fast"}, None),
    ],
)
def test_exposure_is_what_exif_says_and_nothing_where_that_is_no_exposure(
    changes: dict[int, object], expected: float | None, tmp_path: Path, settings, photo
) -> None:
    exif = Image.Exif()
    exif.get_ifd(0x8769).update({tag: value for tag, value in (_EXPOSURE | changes).items() if value is not None})
    (tmp_path / "a.jpg").write_bytes(photo(3, (40, 24), "JPEG", exif=exif))
    exposure_ev = check_image(tmp_path, "a.jpg", settings).exposure_ev
    assert exposure_ev == (None if expected is None else pytest.approx(expected))


def _saved(array: np.ndarray, path: Path, mode: str | None = None) -> Path:
    image = Image.fromarray(array)
    (image if mode is None else image.convert(mode)).save(path)
    return path


def test_every_mode_becomes_rgb(tmp_path: Path, settings) -> None:
    gray = np.arange(256, dtype=np.uint8).reshape(16, 16)
    color = np.stack([gray, gray[::-1], gray.T], axis=-1)
    opaque = np.arange(16)[:, None, None] >= 8
    clear = np.concatenate([color, np.broadcast_to(255 * opaque, (16, 16, 1)).astype(np.uint8)], axis=2)
    expected = {
        "gray.png": (_saved(gray, tmp_path / "gray.png"), np.repeat(gray[..., None], 3, 2)),
        "deep.png": (_saved(gray.astype(np.uint16) << 8 | 77, tmp_path / "deep.png"), np.repeat(gray[..., None], 3, 2)),
        "rgb.bmp": (_saved(color, tmp_path / "rgb.bmp"), color),
        "rgb.tif": (_saved(color, tmp_path / "rgb.tif"), color),
        "one.png": (_saved(gray, tmp_path / "one.png", "1"), None),
        "palette.png": (_saved(color, tmp_path / "palette.png", "P"), None),
        "cmyk.jpg": (_saved(color, tmp_path / "cmyk.jpg", "CMYK"), None),
        "clear.png": (_saved(clear, tmp_path / "clear.png"), np.where(opaque, color, 0)),
        "rgb.webp": (_saved(color, tmp_path / "rgb.webp"), None),
    }
    for name, (_, pixels) in expected.items():
        loaded = load_upright(tmp_path, check_image(tmp_path, name, settings), settings)
        assert loaded.shape == (16, 16, 3)
        assert loaded.dtype == np.uint8
        if pixels is not None:
            np.testing.assert_array_equal(loaded, pixels)


@pytest.mark.parametrize("form", ["JPEG", "PNG", "WEBP", "TIFF"])
def test_a_cut_is_detected_wherever_it_is(form: str, photo, refuses) -> None:
    whole = photo(1, (256, 192), form)
    for share in (0.3, 0.6, 0.9):
        refuses({"good.jpg": photo(2), "cut.jpg": whole[: int(len(whole) * share)]}, CorruptImageError, "cut.jpg")


def test_pixel_limit_is_the_setting(upload, settings, refused, photo) -> None:
    folder = upload({"a.jpg": photo(1, (64, 48)), "b.jpg": photo(2, (80, 48))})
    assert validate_upload(folder, settings.model_copy(update={"max_image_pixels": 80 * 48})).images == 2
    with refused(LimitExceededError, "b.jpg", "80×48", "MAX_IMAGE_PIXELS"):
        validate_upload(folder, settings.model_copy(update={"max_image_pixels": 80 * 48 - 1}))


_SIZE = (64, 48)


def _picture() -> Image.Image:
    """Red at the top left, else a gray ramp."""
    pixels = np.repeat(np.linspace(40, 220, _SIZE[0]).astype(np.uint8)[None, :, None], 3, 2).repeat(_SIZE[1], 0)
    pixels[:16, :16] = 250, 10, 10
    return Image.fromarray(pixels)


def _heic(orientation: int = 1, focal: int = 26) -> bytes:
    """As an iPhone writes it: stored as the sensor lies, turned by the container, and EXIF says so too."""
    picture = _picture()
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = orientation
    exif[ExifTags.Base.Make], exif[ExifTags.Base.Model] = "Apple", "iPhone 15 Pro"
    exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.FocalLengthIn35mmFilm] = focal
    stream = io.BytesIO()
    pillow_heif.from_pillow(picture).save(stream, quality=95, exif=exif.tobytes())
    return stream.getvalue()


@pytest.mark.parametrize("orientation", [1, 3, 6, 8])
def test_it_is_upright_once(orientation: int, tmp_path: Path, settings) -> None:
    (tmp_path / "a.heic").write_bytes(_heic(orientation))
    info = check_image(tmp_path, "a.heic", settings)
    upright = load_upright(tmp_path, info, settings)
    turns = {1: 0, 3: 2, 6: 3, 8: 1}[orientation]
    expected = np.rot90(np.asarray(_picture()), turns)
    assert info.upright_size == expected.shape[1::-1] == upright.shape[1::-1]
    assert np.abs(upright.astype(int) - expected).mean() < 4
    assert (info.focal_35mm, info.lens) == (26.0, "Apple/iPhone 15 Pro/26")
    assert read_size(tmp_path, "a.heic", settings) == info.upright_size


def test_a_capture_of_heic_photos(upload, settings, tmp_path: Path) -> None:
    photos = {f"images/{i}.HEIC": _heic(6) for i in range(2)}
    document = {**PINHOLE, "w": 48, "h": 64, "cx": 24.0, "cy": 32.0, "frames": frames_of(photos)}
    points = points_file((0, 0, -2))
    folder = upload({**photos, "transforms.json": json.dumps(document).encode(), "points3d.ply": points})
    (tmp_path / "check").mkdir()
    request = {"upload": str(folder), "settings": settings.model_dump()}
    run_sandboxed("validate", request, tmp_path / "check", settings, lambda fraction, message: None)
    capture = build_capture(folder, tmp_path / "out", settings, silent)
    for view in capture.views:
        image = load_image(view)
        assert image.shape == (64, 48, 3)
        assert image[4, -4, 0] > 180 and image[4, -4, 1] < 80  # the red corner is at the top right now


def _claiming(width: int, height: int) -> bytes:
    """A photo whose header says another size than its content has."""
    content = bytearray(_heic())
    at = content.index(b"ispe") + 8
    struct.pack_into(">II", content, at, width, height)
    return bytes(content)


@pytest.mark.parametrize(
    ("content", "kind"),
    [
        (_claiming(30_000, 30_000), CorruptImageError),
        (_claiming(2_000_000_000, 2_000_000_000), FastSplatError),
        (_claiming(16, 16), CorruptImageError),
        (_claiming(0, 48), CorruptImageError),
        (_heic()[:-200], CorruptImageError),
        (_heic()[:60], CorruptImageError),
        (b"\0\0\0\x18ftypheic" + bytes(400), CorruptImageError),
        (b"\0\0\0\x18ftypmp42" + bytes(400), CorruptImageError),
    ],
)
def test_what_is_no_photo_is_refused(content: bytes, kind: type[FastSplatError], tmp_path: Path, settings) -> None:
    (tmp_path / "a.heic").write_bytes(content)
    with pytest.raises(kind) as caught:
        check_image(tmp_path, "a.heic", settings)
    assert caught.value.hint and "a.heic" in caught.value.field


def test_pixels_are_counted_before_they_are_decoded(tmp_path: Path, settings) -> None:
    """With damaged content, so that decoding fails."""
    content = bytearray(_heic())
    at = content.index(b"mdat") + 4
    content[at : at + 80] = bytes(80)
    (tmp_path / "a.heic").write_bytes(content)
    with pytest.raises(CorruptImageError, match="damaged"):
        check_image(tmp_path, "a.heic", settings)
    with pytest.raises(LimitExceededError, match="64×48"):
        check_image(tmp_path, "a.heic", settings.model_copy(update={"max_image_pixels": 3_000}))


def test_its_library_is_loaded_by_such_a_photo_only(tmp_path: Path) -> None:
    Image.new("RGB", _SIZE).save(tmp_path / "a.jpg")
    program = """
import sys
from pathlib import Path
from fastsplat.service.capture.formats.image_io import check_image
from fastsplat.service.capture.capture_settings import CaptureSettings
check_image(Path(sys.argv[1]), "a.jpg", CaptureSettings())
print(sum(name.split(".")[0] in ("pi_heif", "_pi_heif", "pillow_heif") for name in sys.modules))
"""
    output = subprocess.run([sys.executable, "-c", program, str(tmp_path)], capture_output=True, check=True).stdout
    assert output.strip() == b"0"
