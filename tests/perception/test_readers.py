"""Words and codes in drawn pictures, by the real reader."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from fastsplat.service.capture.world.scale_tags import draw_tag
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.readers.ppocr import PpOcr, find_reader, open_reader
from fastsplat.service.perception.readers.printed_codes import read_codes
from fastsplat_contract.errors import ModelUnavailableError

_WORDS = ("oat milk", "To the Lighthouse", "230 V")
_LEFT, _ODD, _RIGHT = (
    "0001101 0011001 0010011 0111101 0100011 0110001 0101111 0111011 0110111 0001011".split(),
    "0100111 0110011 0011011 0100001 0011101 0111001 0000101 0010001 0001001 0010111".split(),
    "1110010 1100110 1101100 1000010 1011100 1001110 1010000 1000100 1001000 1110100".split(),
)
_PARITY = "LLLLLL LLGLGG LLGGLG LLGGGL LGLLGG LGGLLG LGGGLL LGLGLG LGLGGL LGGLGL".split()


def _page(words: tuple[str, ...], height_px: int = 26) -> NDArray[np.uint8]:
    """uint8 [480, 640, 3]: a line each, on a card of its own."""
    page = Image.new("RGB", (640, 480), (120, 110, 100))
    drawing, font = ImageDraw.Draw(page), ImageFont.load_default(height_px)
    for row, text in enumerate(words):
        drawing.rectangle((60, 50 + 130 * row, 420, 120 + 130 * row), fill=(236, 230, 214))
        drawing.text((80, 70 + 130 * row), text, font=font, fill=(30, 30, 60))
    return np.asarray(page)


def _ean13(digits: str) -> NDArray[np.uint8]:
    """Draws a bar code of 13 digits (GS1 General Specifications, 5.2.1), two pixels a module, with a margin."""
    sides = _PARITY[int(digits[0])]
    left = "".join((_LEFT if side == "L" else _ODD)[int(digit)] for side, digit in zip(sides, digits[1:7], strict=True))
    bars = f"101{left}01010{''.join(_RIGHT[int(digit)] for digit in digits[7:])}101"
    row = np.array([0 if bar == "1" else 255 for bar in bars], np.uint8)
    return np.pad(np.repeat(np.tile(row, (80, 1)), 2, axis=1), 400, constant_values=255)


def _in_colors(gray: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.asarray(cv2.cvtColor(gray, cv2.COLOR_GRAY2RGB), np.uint8)


@pytest.fixture(scope="module")
def reader(reader_models_dir: Path) -> PpOcr:
    return open_reader(PerceptionSettings(threads=2), reader_models_dir)


@pytest.mark.parametrize("quarters", [0, 1, 2, 3])
def test_lines_are_read_whichever_way_they_run(reader: PpOcr, quarters: int) -> None:
    page = _page(_WORDS)
    lines = reader.read(np.ascontiguousarray(np.rot90(page, quarters)))
    assert sorted(line.text for line in lines) == sorted(_WORDS)
    assert all(line.kind == "text" and 0.5 < line.probability <= 1 for line in lines)


def test_lines_lie_where_they_are_written(reader: PpOcr) -> None:
    by_text = {line.text: line.corners for line in reader.read(_page(_WORDS))}
    for row, text in enumerate(_WORDS):
        left, top = by_text[text].min(axis=0)
        right, bottom = by_text[text].max(axis=0)
        assert 60 <= left <= 82 < right <= 420 and 50 + 130 * row <= top < bottom <= 120 + 130 * row


def test_nothing_is_read_where_nothing_is_written(reader: PpOcr) -> None:
    noise = np.random.default_rng(3).integers(0, 255, (300, 400, 3), np.uint8)
    assert reader.read(_page(())) == [] and reader.read(noise) == []


def test_a_reader_that_was_never_fetched_is_none_and_half_of_one_is_an_error(
    reader_models_dir: Path, tmp_path: Path
) -> None:
    settings = PerceptionSettings()
    assert find_reader(settings, tmp_path) is None
    assert find_reader(PerceptionSettings(reader=""), reader_models_dir) is None
    folder = tmp_path / settings.reader
    folder.mkdir()
    detection, _ = PpOcr.FILES
    shutil.copyfile(reader_models_dir / settings.reader / detection, folder / detection)
    with pytest.raises(ModelUnavailableError, match="recognition"):
        find_reader(settings, tmp_path)
    other_folder = tmp_path / "own"
    other_folder.mkdir()
    for name in PpOcr.FILES:  # the detector says nothing of characters
        shutil.copyfile(reader_models_dir / settings.reader / detection, other_folder / name)
    with pytest.raises(ModelUnavailableError, match="which characters"):
        open_reader(PerceptionSettings(reader="ppocr:own"), tmp_path)


def test_codes_say_what_was_coded() -> None:
    coded = cv2.QRCodeEncoder.create().encode("https://example.org/oats?x=1")
    square = cv2.resize(coded, None, fx=6, fy=6, interpolation=cv2.INTER_NEAREST)
    (code,) = read_codes(_in_colors(np.pad(square, 60, constant_values=255)))
    assert (code.kind, code.text) == ("qr", "https://example.org/oats?x=1")
    (bars,) = read_codes(_in_colors(_ean13("4006381333931")))
    assert (bars.kind, bars.text) == ("barcode", "4006381333931")
    (tag,) = read_codes(_in_colors(np.pad(draw_tag(17, 12), 60, constant_values=255)))
    assert (tag.kind, tag.text) == ("tag", "17")
    assert np.allclose(tag.corners, np.array([[72, 72], [168, 72], [168, 168], [72, 168]]), atol=2)
    assert read_codes(_page(_WORDS)) == []
