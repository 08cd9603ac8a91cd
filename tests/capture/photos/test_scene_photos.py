"""Small copies of photos that stay with a scene."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fastsplat.service.capture.capture_settings import PhotoSettings
from fastsplat.service.capture.captures import Capture, CaptureReport, Source, View
from fastsplat.service.capture.photos.scene_photos import (
    kept_lenses,
    observed_photo_path,
    photo_path,
    share_photos,
    write_observed_photos,
    write_photos,
)
from fastsplat.service.common.radial_lens import RadialLens
from fastsplat_contract.errors import SceneFileError
from fastsplat_contract.geometry.camera import Camera, PosedCamera


def _capture(folder: Path, *sizes: tuple[int, int], source: Source = "images") -> Capture:
    """Photos with a gradient from left to right and a header that says where they were taken."""
    views = []
    for number, (width, height) in enumerate(sizes):
        pixels = np.zeros((height, width, 3), np.uint8)
        pixels[..., 0], pixels[..., 1] = np.linspace(0, 255, width), 40 * number
        path, exif = folder / f"{number}.jpg", Image.Exif()
        exif[0x0110] = "a phone"
        Image.fromarray(pixels).save(path, quality=95, exif=exif, comment=b"the kitchen")
        camera = Camera(width, height, width, width, width / 2, height / 2)
        views.append(View(PosedCamera(camera, np.eye(4), f"../{number}.jpg"), path))
    points = np.zeros((0, 3))
    report = CaptureReport(source, len(sizes))
    return Capture(tuple(views), points.astype(np.float32), points.astype(np.uint8), "ARBITRARY", report)


def test_copies_are_small_pictures_of_their_cameras_and_hold_nothing_else(tmp_path: Path) -> None:
    capture = _capture(tmp_path, (1600, 1200), (300, 400), (2048, 200))
    folder = tmp_path / "version"
    folder.mkdir()
    progress: list[int] = []
    assert write_photos(capture, folder, PhotoSettings(max_side=512), progress.append) == 3 and progress == [0, 1, 2]
    expected = [(512, 384), (300, 400), (512, 50)]
    for number, (size, view) in enumerate(zip(expected, capture.views, strict=True)):
        with Image.open(photo_path(folder, number)) as image:
            assert image.format == "JPEG" and image.size == size
            assert not image.getexif() and "comment" not in image.info
            pixels = np.asarray(image, dtype=np.float64)
        # The same place of the picture has the same color: the camera fits with its intrinsics scaled.
        assert np.abs(pixels[..., 0].mean(axis=0) - np.linspace(0, 255, size[0])).mean() < 3
        assert pixels[..., 1].mean() == pytest.approx(40 * number, abs=3)
        assert view.image_path.is_file()
    stored = sorted(path.name for path in folder.rglob("*.*"))
    assert stored == ["00000.jpg", "00001.jpg", "00002.jpg", "lenses.json"]


def test_a_lower_quality_is_smaller(tmp_path: Path) -> None:
    noise = np.random.default_rng(0).integers(0, 255, (300, 400, 3), dtype=np.uint8)
    capture = _capture(tmp_path, (400, 300))
    Image.fromarray(noise).save(capture.views[0].image_path, quality=95)
    sizes = []
    for quality in (40, 90):
        folder = tmp_path / str(quality)
        folder.mkdir()
        write_photos(capture, folder, PhotoSettings(quality=quality))
        sizes.append(photo_path(folder, 0).stat().st_size)
    assert sizes[0] < sizes[1] / 2


def test_a_copy_has_the_colors_of_single_pixels(tmp_path: Path) -> None:
    capture = _capture(tmp_path, (400, 300))
    columns = np.zeros((300, 400, 3), np.uint8)
    columns[:, ::2, 0], columns[:, 1::2, 2] = 120, 120
    Image.fromarray(columns).save(capture.views[0].image_path, quality=95, subsampling=0)
    folder = tmp_path / "version"
    folder.mkdir()
    write_photos(capture, folder, PhotoSettings())
    write_observed_photos([columns], folder, "e7", PhotoSettings())
    for path in (photo_path(folder, 0), observed_photo_path(folder, "e7", 0)):
        with Image.open(path) as image:
            assert np.abs(np.asarray(image).astype(float) - columns).mean() < 10


def test_none_are_stored_where_the_settings_say_so_or_pictures_were_rendered(tmp_path: Path) -> None:
    capture = _capture(tmp_path, (64, 48))
    folder = tmp_path / "version"
    folder.mkdir()
    assert write_photos(capture, folder, PhotoSettings(keep="off")) == 0
    rendered = replace(capture, report=replace(capture.report, source="splat"))
    assert write_photos(rendered, folder, PhotoSettings()) == 0
    assert list(folder.iterdir()) == []


def test_versions_share_their_photos_or_have_none(tmp_path: Path) -> None:
    first, second, third = (tmp_path / name for name in ("first", "second", "third"))
    for folder in (first, second, third):
        folder.mkdir()
    share_photos(first, third)
    assert list(third.iterdir()) == []
    write_photos(_capture(tmp_path, (64, 48), (48, 64)), first, PhotoSettings())
    share_photos(first, second)
    for number in range(2):
        assert photo_path(second, number).samefile(photo_path(first, number))


def test_lenses_are_kept_with_the_photos(tmp_path: Path) -> None:
    capture, lens = _capture(tmp_path, (64, 48), (64, 48)), RadialLens(0.8, -0.02)
    capture = replace(capture, views=(capture.views[0], replace(capture.views[1], lens=lens)))
    assert kept_lenses(tmp_path) == ()
    write_photos(capture, tmp_path, PhotoSettings())
    assert kept_lenses(tmp_path) == (lens,)


@pytest.mark.parametrize(
    "damaged", [b"", b"\xff\xfe[", b'[{"focal": 0.8', b'{"focal": 1}', b'[{"focal": null, "k1": 0}]']
)
def test_a_damaged_file_of_lenses_is_said_to_be(tmp_path: Path, damaged: bytes) -> None:
    write_photos(_capture(tmp_path, (64, 48)), tmp_path, PhotoSettings())
    (tmp_path / "photos" / "lenses.json").write_bytes(damaged)
    with pytest.raises(SceneFileError) as caught:
        kept_lenses(tmp_path)
    assert caught.value.field == "lenses.json"
