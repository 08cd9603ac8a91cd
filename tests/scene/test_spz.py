"""SPZ files: rows in order, within the stated error, and as the tests' own writer writes them."""

from __future__ import annotations

import gzip
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

from fastsplat.service.capture.uploads.splat_files.rows import SplatLimits, SplatRows
from fastsplat.service.capture.uploads.splat_files.spz import read_spz
from fastsplat.service.scene.artefact.scene import Gaussians
from fastsplat.service.scene.formats.spz_writing import MOST_FRACTIONAL_BITS, fractional_bits, spz_bytes
from tests.capture.splat_writers import spz_content
from tests.scene.conftest import make_gaussians


def _back(gaussians: Gaussians, folder: Path, version: Literal[3, 4] = 3) -> SplatRows:
    (folder / "a.spz").write_bytes(spz_bytes(gaussians, version))
    return read_spz(folder / "a.spz", "a.spz", SplatLimits(10**6))


def _opacity(logits: np.ndarray) -> np.ndarray:
    with np.errstate(over="ignore"):
        return np.asarray(1 / (1 + np.exp(-logits.astype(np.float64))))


@pytest.mark.parametrize("sh", [1, 4, 9, 16])
@pytest.mark.parametrize(("far", "version"), [(1.0, 3), (300.0, 4)])
def test_what_comes_back_is_within_the_stated_error_in_order(
    tmp_path: Path, sh: int, far: float, version: Literal[3, 4]
) -> None:
    drawn = make_gaussians(3_000, sh)
    gaussians = replace(drawn, means=drawn.means * np.float32(far), sh=np.clip(drawn.sh, -0.99, 0.99))
    back = _back(gaussians, tmp_path, version)
    step = 2.0 ** -fractional_bits(gaussians.means)
    assert np.abs(back.means - gaussians.means).max() <= step / 2 + 1e-7 * far
    assert np.abs(_opacity(back.logit_opacities) - _opacity(gaussians.logit_opacities)).max() <= 1 / 510 + 1e-6
    assert np.abs(back.log_scales - gaussians.log_scales).max() <= 1 / 32 + 1e-6
    assert np.abs(back.sh[:, 0] - gaussians.sh[:, 0]).max() <= 1 / 76
    assert np.abs(back.sh[:, 1:] - gaussians.sh[:, 1:]).max(initial=0) <= 1 / 256 + 1e-6
    unit = gaussians.quats / np.linalg.norm(gaussians.quats, axis=1, keepdims=True)
    same = np.sign((unit * back.quats).sum(axis=1, keepdims=True))
    apart = np.sort(np.abs(unit - same * back.quats), axis=1)
    assert apart[:, :3].max() <= 1 / 1445 + 1e-6 and np.abs((unit * back.quats).sum(axis=1)).min() > 0.999995


def test_it_is_the_file_that_another_writer_writes() -> None:
    drawn = make_gaussians(200)
    gaussians = replace(drawn, sh=np.clip(drawn.sh, -0.99, 0.99))
    ours = np.frombuffer(gzip.decompress(spz_bytes(gaussians)), np.uint8)
    theirs = np.frombuffer(spz_content(gaussians, bits=MOST_FRACTIONAL_BITS), np.uint8)
    assert ours.shape == theirs.shape and (ours[:16] == theirs[:16]).all()
    assert (ours != theirs).mean() < 0.001  # a half is rounded in single or in double precision
    assert spz_bytes(gaussians) == spz_bytes(gaussians)


def test_what_the_format_cannot_hold_becomes_the_nearest_it_can(tmp_path: Path) -> None:
    drawn = make_gaussians(4, 4)
    means = np.array([[1e9, 0, 0], [0, -1e9, 0], [0, 0, 1], [1, 2, 3]], np.float32)
    gaussians = replace(drawn, means=means, log_scales=np.full((4, 3), -30, np.float32), sh=drawn.sh * 1_000)
    back = _back(gaussians, tmp_path)
    assert fractional_bits(means) == 8
    assert np.abs(back.means[2:] - means[2:]).max() == 0 and back.means[0, 0] == -back.means[1, 1] > 32_000
    assert (back.log_scales == -10).all() and np.abs(back.sh[:, 0]).max() < 3.4 and np.abs(back.sh[:, 1:]).max() <= 1


def test_a_splat_of_nothing_is_a_file() -> None:
    for content in (gzip.decompress(spz_bytes(make_gaussians(0, 4))), spz_bytes(make_gaussians(0, 4), 4)):
        assert len(content) in (16, 32) and content[:4] == b"NGSP" and content[8:12] == bytes(4)
