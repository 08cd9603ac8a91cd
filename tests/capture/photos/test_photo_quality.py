"""What the pixels, the pose and the matches of a photo say of it, also before it is posted."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from fastsplat.service.capture.build import build_capture
from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.formats.capture_files import load_capture
from fastsplat.service.capture.formats.image_io import load_rgb
from fastsplat.service.capture.photos.photo_quality import PhotoMatches, PhotoQuality, judge_photos, measure_photo
from fastsplat.service.capture.uploads.photo_check import check_photos
from fastsplat.service.capture.uploads.upload_validation import validate_upload
from fastsplat.service.common.progress import silent
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.photos.photo_verdicts import PhotoVerdict
from tests.commands import invoke

_SCENES = ("tabletop", "kitchen", "plush", "skull")


def _judged(qualities: list[PhotoQuality], **poses: NDArray[np.float64]) -> dict[str, PhotoVerdict]:
    return {verdict.name: verdict for verdict in judge_photos(qualities, poses, None)}


@pytest.mark.parametrize("scene", _SCENES)
def test_real_photos_are_fine_and_those_that_shook_are_not(scene: str, test_data: Path) -> None:
    photos = [load_rgb(path) for path in sorted((test_data / scene / "images").glob("*.*"))[:24]]
    width = photos[0].shape[1]
    qualities = [measure_photo(f"{number:02}", photo) for number, photo in enumerate(photos)]
    fine = judge_photos(qualities, {quality.name: _pose(number) for number, quality in enumerate(qualities)}, None)
    assert {(verdict.placed, verdict.defects, verdict.advice) for verdict in fine} == {(True, (), "")}
    out_of_focus = cv2.GaussianBlur(photos[3], (0, 0), width / 300)
    shaken = cv2.blur(photos[7], (width // 50, width // 50))
    changed = list(qualities)
    changed[3], changed[7] = measure_photo("03", out_of_focus), measure_photo("07", shaken)
    verdicts = _judged(changed)
    assert {name for name, verdict in verdicts.items() if "blurred" in verdict.defects} == {"03", "07"}
    assert "sharp" in verdicts["03"].advice and verdicts["03"].sharpness < 0.5


def _pose(x: float) -> NDArray[np.float64]:
    pose = np.eye(4)
    pose[0, 3] = x
    return pose


def test_the_same_photo_again_is_a_duplicate_of_the_sharper_one(test_data: Path) -> None:
    photos = [load_rgb(path) for path in sorted((test_data / "skull/images").glob("*.*"))[:5]]
    qualities = [measure_photo(f"{number}.jpg", photo) for number, photo in enumerate(photos)]
    softer = cv2.GaussianBlur(photos[2], (0, 0), 0.8)
    qualities.append(measure_photo("0-first.jpg", softer))
    verdicts = _judged(qualities)
    assert verdicts["0-first.jpg"].duplicate_of == "2.jpg" and "2.jpg" in verdicts["0-first.jpg"].advice
    assert [name for name, verdict in verdicts.items() if verdict.defects] == ["0-first.jpg"]


def test_photos_that_look_alike_from_different_places_are_no_duplicates() -> None:
    wall = np.random.default_rng(1).integers(100, 140, (60, 80, 3), dtype=np.uint8)
    qualities = [measure_photo(name, wall) for name in ("a", "b", "c")]
    apart = _judged(qualities, a=_pose(0), b=_pose(1), c=_pose(2))
    assert all(verdict.duplicate_of == "" for verdict in apart.values())
    together = _judged(qualities, a=_pose(0), b=_pose(0.001), c=_pose(2))
    assert [verdict.duplicate_of for verdict in together.values()] == ["", "a", ""]


@pytest.mark.parametrize(
    ("matches", "reason"),
    [
        (PhotoMatches(12, 0, other_model=False), "few_features"),
        (PhotoMatches(900, 0, other_model=False), "no_overlap"),
        (PhotoMatches(900, 40, other_model=False), "few_matches"),
        (PhotoMatches(900, 200, other_model=True), "other_model"),
    ],
)
def test_why_a_photo_has_no_place(matches: PhotoMatches, reason: str) -> None:
    noise = np.random.default_rng(2).integers(0, 255, (60, 80, 3), dtype=np.uint8)
    (verdict,) = judge_photos([measure_photo("a", noise)], {}, {"a": matches})
    assert (verdict.placed, verdict.not_placed, verdict.matches) == (False, reason, matches.best)
    assert verdict.advice.endswith(".")


def test_a_photo_without_a_place_says_between_which_two_one_would_help() -> None:
    noise = np.random.default_rng(2).integers(0, 255, (60, 80, 3), dtype=np.uint8)
    qualities = [measure_photo(name, noise) for name in ("a", "b", "c")]
    matches = {
        "a": PhotoMatches(900, 300, other_model=False, nearest_placed="b"),
        "b": PhotoMatches(900, 300, other_model=False),
        "c": PhotoMatches(900, 20, other_model=False, nearest_placed="a"),
    }
    placed, _, left = judge_photos(qualities, {"a": _pose(0), "b": _pose(2)}, matches)
    assert (placed.between, placed.advice) == ((), "")
    assert left.between == ("a", "c") and "between a and this one" in left.advice
    alone = judge_photos(qualities, {}, {"c": PhotoMatches(900, 0, other_model=False)})[2]
    assert alone.between == () and "between" not in alone.advice.split("take more between it and them")[-1]


def test_one_photo_and_none_are_judged_too() -> None:
    black = measure_photo("a", np.zeros((1, 1, 3), np.uint8))
    (verdict,) = judge_photos([black], {"a": np.eye(4)}, None)
    assert verdict.placed and verdict.defects == ("dark",) and verdict.sharpness == 1.0
    assert judge_photos([], {}, None) == ()


def test_a_capture_says_what_became_of_each_photo(test_data: Path, tmp_path: Path) -> None:
    """Nine photos of a table, one of them twice and one shaken; one of another place."""
    settings = CaptureSettings(sfm_threads=2)
    folder = tmp_path / "upload" / "images"
    folder.mkdir(parents=True)
    for number in range(0, 36, 4):
        pixels = load_rgb(test_data / f"tabletop/images/{number:03d}.jpg")
        if number == 16:
            pixels = np.asarray(cv2.blur(pixels, (31, 31)), dtype=np.uint8)
        Image.fromarray(pixels).save(folder / f"{number:03d}.jpg", quality=95)
    Image.open(folder / "008.jpg").save(folder / "again.jpg", quality=80)
    Image.open(test_data / "kitchen/images/05.jpg").save(folder / "kitchen.jpg")
    validate_upload(folder.parent, settings)
    report = build_capture(folder.parent, tmp_path / "out", settings, silent).report
    verdicts = {verdict.name: verdict for verdict in report.photos}
    assert list(verdicts) == sorted(path.name for path in folder.iterdir())
    assert {name for name, verdict in verdicts.items() if not verdict.placed} == set(report.unregistered)
    assert not verdicts["kitchen.jpg"].placed and verdicts["kitchen.jpg"].not_placed in ("no_overlap", "few_matches")
    assert all(verdict.between == () for verdict in verdicts.values() if verdict.placed)
    assert verdicts["016.jpg"].defects == ("blurred",)
    pair = verdicts["008.jpg"], verdicts["again.jpg"]
    assert sorted(verdict.duplicate_of for verdict in pair) in (["", "008.jpg"], ["", "again.jpg"])
    assert (verdicts["000.jpg"].placed, verdicts["000.jpg"].defects, verdicts["000.jpg"].advice) == (True, (), "")
    assert (verdicts["000.jpg"].matches or 0) > 50
    assert load_capture(tmp_path / "out").report == report


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
    (photos / "broken.png").write_text("no picture")
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
    assert checked.advice[0].startswith("left out: broken.png: ") and "8 different photos are few" in checked.advice[1]
    assert checked.size == (600, 400)
    result = invoke("check", str(photos))
    assert re.search(r"takes about \d+ (s|min) on this machine", result.stderr)
    assert result.exit_code == 1 and "elsewhere.png: It shares nothing" in result.stdout
    assert "overlap is a rough guess" in result.stderr


def test_what_is_no_folder_of_photos_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError):
        check_photos(tmp_path / "none", tmp_path, CaptureSettings())
