"""Photos: orientation, modes, limits."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageOps
from PIL.TiffImagePlugin import IFDRational

from fastsplat.service.capture.formats.image_io import check_image, load_upright, open_map
from fastsplat.service.capture.uploads.upload_validation import validate_upload
from fastsplat_contract.errors import CorruptImageError, InvalidInputError, LimitExceededError
from tests.capture.upload_files import encoded, turned


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
    expected = {
        "gray.png": (_saved(gray, tmp_path / "gray.png"), np.repeat(gray[..., None], 3, 2)),
        "deep.png": (_saved(gray.astype(np.uint16) << 8 | 77, tmp_path / "deep.png"), np.repeat(gray[..., None], 3, 2)),
        "rgb.bmp": (_saved(color, tmp_path / "rgb.bmp"), color),
        "rgb.tif": (_saved(color, tmp_path / "rgb.tif"), color),
        "one.png": (_saved(gray, tmp_path / "one.png", "1"), None),
        "palette.png": (_saved(color, tmp_path / "palette.png", "P"), None),
        "cmyk.jpg": (_saved(color, tmp_path / "cmyk.jpg", "CMYK"), None),
        "rgb.webp": (_saved(color, tmp_path / "rgb.webp"), None),
    }
    for name, (_, pixels) in expected.items():
        loaded = load_upright(tmp_path, check_image(tmp_path, name, settings), settings)
        assert loaded.shape == (16, 16, 3)
        assert loaded.dtype == np.uint8
        if pixels is not None:
            np.testing.assert_array_equal(loaded, pixels)


def test_transparent_is_black(tmp_path: Path, settings) -> None:
    rgba = np.full((8, 8, 4), 200, np.uint8)
    rgba[:4, :, 3] = 0
    rgba[4:, :, 3] = 255
    Image.fromarray(rgba).save(tmp_path / "a.png")
    loaded = load_upright(tmp_path, check_image(tmp_path, "a.png", settings), settings)
    assert (loaded[:4] == 0).all() and (loaded[4:] == 200).all()


@pytest.mark.parametrize("form", ["JPEG", "PNG", "WEBP", "TIFF"])
def test_a_cut_is_detected_wherever_it_is(form: str, photo, refuses) -> None:
    whole = photo(1, (256, 192), form)
    for share in (0.3, 0.6, 0.9):
        refuses({"good.jpg": photo(2), "cut.jpg": whole[: int(len(whole) * share)]}, CorruptImageError, "cut.jpg")


def test_huge_image_is_refused_by_its_header(photo, refuses) -> None:
    huge = encoded(Image.new("1", (30_000, 30_000)))
    refuses({"good.jpg": photo(2), "huge.png": huge}, LimitExceededError, "huge.png", "MAX_IMAGE_PIXELS")


def test_pixel_limit_is_the_setting(upload, settings, refused, photo) -> None:
    folder = upload({"a.jpg": photo(1, (64, 48)), "b.jpg": photo(2, (80, 48))})
    assert validate_upload(folder, settings.model_copy(update={"max_image_pixels": 80 * 48})).images == 2
    with refused(LimitExceededError, "b.jpg", "80×48"):
        validate_upload(folder, settings.model_copy(update={"max_image_pixels": 80 * 48 - 1}))


def test_map_with_colors(tmp_path: Path, settings, photo) -> None:
    (tmp_path / "m.png").write_bytes(photo(1, form="PNG"))
    with pytest.raises(InvalidInputError, match=r"m\.png"):
        open_map(tmp_path, "m.png", settings)
