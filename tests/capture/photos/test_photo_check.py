"""Photos judged before they are posted: few, dark, alike, blurred, alone; the folder stays as it is."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.uploads.photo_check import check_photos
from fastsplat_contract.errors import InvalidInputError
from tests.commands import invoke


def _textured(seed: int, side: int = 900) -> np.ndarray:
    random = np.random.default_rng(seed)
    picture = np.full((side, side, 3), 128, np.uint8)
    for _ in range(500):
        corner = random.integers(0, side, 2)
        size = random.integers(5, 60, 2)
        color = tuple(int(value) for value in random.integers(0, 255, 3))
        cv2.rectangle(picture, corner.tolist(), (corner + size).tolist(), color, -1)
    return picture


def test_each_defect_is_named_and_the_folder_is_left_alone(tmp_path: Path) -> None:
    photos = tmp_path / "photos"
    photos.mkdir()
    wall = _textured(0)
    for number in range(5):
        Image.fromarray(wall[100:500, 40 * number : 40 * number + 600]).save(photos / f"{number}.png")
    blurred = cv2.GaussianBlur(wall[150:550, 30:630], (0, 0), 8)
    Image.fromarray(blurred).save(photos / "blurred.png")
    Image.fromarray((wall[120:520, 60:660] // 12).astype(np.uint8)).save(photos / "dark.png")
    Image.fromarray(wall[100:500, 40:640]).save(photos / "same.png")
    Image.fromarray(_textured(1)[:400, :600]).save(photos / "elsewhere.png")
    before = sorted(path.name for path in photos.iterdir())
    (tmp_path / "scratch").mkdir()
    checked = check_photos(photos, tmp_path / "scratch", CaptureSettings())
    found = {photo.name: photo for photo in checked.photos}
    assert sorted(path.name for path in photos.iterdir()) == before
    assert "blurred" in found["blurred.png"].defects and "dark" in found["dark.png"].defects
    assert "duplicate" in {*found["same.png"].defects, *found["1.png"].defects}
    assert found["elsewhere.png"].not_placed == "no_overlap"
    for name in ("0.png", "2.png", "3.png", "4.png"):
        assert found[name].not_placed is None and not found[name].defects and not found[name].advice
    assert any("8 different photos are few" in sentence for sentence in checked.advice) and not checked.is_good
    assert checked.size == (600, 400)
    result = invoke("check", str(photos))
    assert re.search(r"takes about \d+ (s|min) on this machine", result.stderr)
    assert result.exit_code == 1 and "elsewhere.png: It shares nothing" in result.stdout


def test_what_is_no_folder_of_photos_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError):
        check_photos(tmp_path / "none", tmp_path, CaptureSettings())
