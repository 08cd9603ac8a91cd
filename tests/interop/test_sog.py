"""SOG files, as PlayCanvas' own program reads them."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from fastsplat.service.scene.artefact.scene import Gaussians
from fastsplat.service.scene.formats.ply import read_ply
from fastsplat.service.scene.formats.sog_writing import MOST_GAUSSIANS, palette_entries, sog_bytes
from fastsplat.service.scene.gaussians.morton import morton_order
from fastsplat_contract.errors import LimitExceededError
from tests.scene.conftest import make_gaussians

Reader = Callable[[Gaussians], Gaussians]


@pytest.fixture
def read_back(splat_transform: Callable[..., None], tmp_path: Path) -> Reader:
    """What the other program makes of our file of some Gaussians, in the order of the file."""

    def read(ours: Gaussians) -> Gaussians:
        (tmp_path / "a.sog").write_bytes(sog_bytes(ours))
        splat_transform(tmp_path / "a.sog", tmp_path / "a.ply")
        return read_ply(tmp_path / "a.ply")

    return read


def _sorted(ours: Gaussians) -> Gaussians:
    order = morton_order(ours.means)
    return replace(ours, **{name: array[order] for name, array in vars(ours).items()})


def _logs(means: NDArray[np.float32]) -> NDArray[np.float64]:
    return np.asarray(np.sign(means) * np.log1p(np.abs(means.astype(np.float64))))


def _opacity(logits: NDArray[np.float32]) -> NDArray[np.float64]:
    return np.asarray(1 / (1 + np.exp(-logits.astype(np.float64))))


def _check_all_but_harmonics(back: Gaussians, ours: Gaussians) -> None:
    """Assert that all is within what `sog_bytes` states."""
    low, high = _logs(ours.means).min(axis=0), _logs(ours.means).max(axis=0)
    assert (np.abs(_logs(back.means) - _logs(ours.means)) <= (high - low) / 65_535 / 2 + 1e-6).all()
    assert np.abs(_opacity(back.logit_opacities) - _opacity(ours.logit_opacities)).max() <= 1 / 510 + 1e-6
    assert np.abs(back.log_scales - ours.log_scales).max() <= np.ptp(ours.log_scales) / 256 + 1e-6
    assert np.abs(back.sh[:, 0] - ours.sh[:, 0]).max() <= np.ptp(ours.sh[:, 0]) / 256 + 1e-6
    unit = ours.quats / np.linalg.norm(ours.quats, axis=1, keepdims=True)
    same = np.sign((unit * back.quats).sum(axis=1, keepdims=True))
    assert np.sort(np.abs(unit - same * back.quats), axis=1)[:, :3].max() <= 1 / 360
    assert np.abs((unit * back.quats).sum(axis=1)).min() > 0.9999


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("far", [0.01, 1.0, 1_000.0])
def test_it_is_read_within_the_stated_error_in_morton_order(degree: int, far: float, read_back: Reader) -> None:
    drawn = make_gaussians(300, (degree + 1) ** 2, 0)
    drawn = replace(drawn, means=drawn.means * np.float32(far))
    ours, back = _sorted(drawn), read_back(drawn)
    assert back.sh.shape == ours.sh.shape
    _check_all_but_harmonics(back, ours)
    if degree:
        assert np.abs(back.sh[:, 1:] - ours.sh[:, 1:]).max() <= np.ptp(ours.sh[:, 1:]) / 256 + 1e-6


def test_more_harmonics_than_the_palette_has_are_those_of_their_like(read_back: Reader) -> None:
    count, noise = 4_000, 0.01
    assert palette_entries(count) < count
    drawn = make_gaussians(count, 16, 0)
    rng = np.random.default_rng(1)
    kinds = rng.normal(size=(20, 15, 3))
    bands = kinds[rng.integers(len(kinds), size=count)] + noise * rng.normal(size=(count, 15, 3))
    ours = _sorted(replace(drawn, sh=np.concatenate([drawn.sh[:, :1], bands.astype(np.float32)], axis=1)))
    back = read_back(ours)
    _check_all_but_harmonics(back, ours)
    within = np.ptp(ours.sh[:, 1:]) / 256
    assert np.sqrt(np.mean((back.sh[:, 1:] - ours.sh[:, 1:]) ** 2)) <= np.hypot(noise, within)


def test_extreme_and_equal_values_are_read(read_back: Reader) -> None:
    drawn = make_gaussians(6, 4, 0)
    means = np.tile(np.array([[2.0, -1e6, 0.0]], np.float32), (6, 1))
    means[:3, 1] = 1e6
    ours = _sorted(
        replace(
            drawn,
            means=means,
            log_scales=np.full((6, 3), -20, np.float32),
            logit_opacities=np.array([-40, -8, 0, 0, 8, 40], np.float32),
            quats=np.array([[0, 0, 0, -2], [1, 1, 1, 1], [-1, 1, -1, 1], [0, 1e-9, 0, 0], [3, 0, 0, 0], [0, 0, 5, 5]]),
        )
    )
    back = read_back(ours)
    _check_all_but_harmonics(back, ours)
    np.testing.assert_array_equal(back.log_scales, ours.log_scales)
    np.testing.assert_allclose(back.means[:, [0, 2]], means[:, [0, 2]], atol=1e-6)


def test_the_file_is_what_the_specification_asks_for() -> None:
    content = sog_bytes(make_gaussians(70, 9, 0))
    assert content == sog_bytes(make_gaussians(70, 9, 0))
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    meta = json.loads(files.pop("meta.json"))
    assert (meta["version"], meta["count"], meta["shN"]["bands"], meta["shN"]["count"]) == (2, 70, 2, 70)
    assert meta["antialias"] is False
    named = [file for entry in meta.values() if isinstance(entry, dict) for file in entry.get("files", ())]
    assert sorted(named) == sorted(files)
    for name, file in files.items():
        picture = Image.open(io.BytesIO(file))
        assert picture.format == "WEBP" and file[12:16] in (b"VP8L", b"VP8X")
        assert picture.size == ((64 * 8, 2) if name == "shN_centroids.webp" else (12, 8))
    tags = np.asarray(Image.open(io.BytesIO(files["quats.webp"])))[..., 3].reshape(-1)[:70]
    assert tags.min() >= 252
    for name in ("scales", "sh0", "shN"):
        assert len(meta[name]["codebook"]) == 256 and np.isfinite(meta[name]["codebook"]).all()


def test_a_splat_of_nothing_is_a_file_and_one_of_too_much_is_refused() -> None:
    with zipfile.ZipFile(io.BytesIO(sog_bytes(make_gaussians(0, 16, 0)))) as archive:
        meta = json.loads(archive.read("meta.json"))
        assert meta["count"] == 0 and "shN" not in meta
        assert Image.open(io.BytesIO(archive.read("means_l.webp"))).size == (4, 4)
    gaussian = make_gaussians(1, 1, 0)
    count = MOST_GAUSSIANS + 1
    huge = {name: np.broadcast_to(array, (count, *array.shape[1:])) for name, array in vars(gaussian).items()}
    with pytest.raises(LimitExceededError) as caught:
        sog_bytes(Gaussians(**huge))
    assert caught.value.field == "format" and str(MOST_GAUSSIANS) in str(caught.value.limit)
