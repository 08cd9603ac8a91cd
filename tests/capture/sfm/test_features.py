"""Where features are found, and which octaves are left out."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest

from fastsplat.service.capture.sfm.features import extract_features

_SIDE = 320
_PLACES = np.random.default_rng(0).permutation(64)[:30]
_CENTERS = np.stack([_PLACES % 8, _PLACES // 8], axis=1) * 40 + 20.5


def _blots(zoom: int = 1) -> np.ndarray:
    """uint8 [side, side]: soft dark blots around the centers, whose pixel centers are at +0.5."""
    y, x = (np.mgrid[: zoom * _SIDE, : zoom * _SIDE] + 0.5) / zoom
    squared = sum((at - _CENTERS[:, axis, None, None]) ** 2 for axis, at in enumerate((x, y)))
    return np.round(200 - 150 * np.exp(-squared / (2 * 5.0**2)).sum(axis=0)).astype(np.uint8)


def _found(folder: Path, pictures: list[np.ndarray], count: int, side: int = 2_000, threads: int = 1, masks=None):
    """Keypoints and descriptors of each picture."""
    files, database = [f"{number}.png" for number in range(len(pictures))], folder / f"{count} {side} {threads}.db"
    for file, picture in zip(files, pictures, strict=True):
        cv2.imwrite(str(folder / file), picture)
    pycolmap.Database.open(database).close()
    pycolmap.import_images(database, folder, image_names=files)
    extract_features(database, folder, files, masks, {"sfm_max_side": side, "sfm_features": count}, threads)
    with pycolmap.Database.open(database) as reader:
        ids = sorted(image.image_id for image in reader.read_all_images())
        return [(np.asarray(reader.read_keypoints(i)), np.asarray(reader.read_descriptors(i).data)) for i in ids]


@pytest.mark.parametrize(("count", "zoom"), [(300, 1), (4_000, 1), (300, 3), (4_000, 3)])
def test_blots_are_found_at_their_centers_in_any_octave_and_size(tmp_path: Path, count: int, zoom: int) -> None:
    ((keypoints, _),) = _found(tmp_path, [_blots(zoom)], count, side=_SIDE)
    apart = np.linalg.norm(keypoints[None, :, :2] / zoom - _CENTERS[:, None], axis=2)
    assert np.median(apart.min(axis=1)) < 0.1


def test_the_finest_octave_is_left_out_where_others_give_half_the_features(tmp_path: Path) -> None:
    noise = np.random.default_rng(1).integers(0, 256, (_SIDE, _SIDE), dtype=np.uint8)
    (all_scales, _), (some, _) = (_found(tmp_path, [noise], count)[0] for count in (40_000, 50))
    assert len(some) == 50 < len(all_scales)
    assert all_scales[:, 2].min() < 1.6 < some[:, 2].min()


def test_features_are_sorted_by_size_and_the_same_on_any_number_of_threads(tmp_path: Path) -> None:
    pictures = [np.random.default_rng(seed).integers(0, 256, (200, 200), dtype=np.uint8) for seed in range(5)]
    for first, second in zip(*(_found(tmp_path, pictures, 60, threads=count) for count in (1, 3)), strict=True):
        assert np.array_equal(first[0], second[0]) and np.array_equal(first[1], second[1])
        assert first[1].shape == (60, 128) and (np.diff(first[0][:, 2]) <= 0).all()


def test_nothing_is_found_where_the_mask_is_black_or_the_picture_plain(tmp_path: Path) -> None:
    (tmp_path / "masks").mkdir()
    mask = np.full((_SIDE, _SIDE), 255, np.uint8)
    mask[:, : _SIDE // 2] = 0
    cv2.imwrite(str(tmp_path / "masks/0.png.png"), mask)
    masked, whole, plain = _found(tmp_path, [_blots(), _blots(), mask * 0], 4_000, masks=tmp_path / "masks")
    assert masked[0][:, 0].min() > _SIDE // 2 - 2 > 40 > whole[0][:, 0].min() and len(plain[0]) == 0
