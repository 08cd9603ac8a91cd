"""Codebooks and palettes: what they promise of every value, and what like rows share."""

from __future__ import annotations

import numpy as np
import pytest

from fastsplat.service.scene.formats.sog_writing import codebook, palette


@pytest.mark.parametrize(
    "values",
    [
        np.random.default_rng(0).normal(size=(5_000, 3)),
        np.random.default_rng(0).standard_cauchy(20_000),
        np.concatenate([np.zeros(10_000), [1.0]]),
        np.linspace(-3e38, 3e38, 1_000),
        np.array([-7.25]),
        np.full((4, 3), 1e-30),
        np.zeros((0, 3)),
    ],
)
def test_no_value_is_further_from_its_entry_than_stated(values: np.ndarray) -> None:
    values = values.astype(np.float32)
    entries, indices = codebook(values)
    assert entries.shape == (256,) and indices.dtype == np.uint8 and indices.shape == values.shape
    assert (np.diff(entries) >= 0).all()
    if values.size:
        wide = float(values.max()) - float(values.min())
        assert np.abs(entries[indices].astype(float) - values).max() <= wide / 256 * (1 + 1e-5) + np.spacing(
            np.abs(values).max()
        )
        nearest = np.abs(entries[None].astype(float) - values.reshape(-1, 1)[:500]).min(axis=1)
        np.testing.assert_allclose(np.abs(entries[indices].astype(float) - values).reshape(-1)[:500], nearest)


def test_entries_are_where_the_values_are() -> None:
    values = np.random.default_rng(0).standard_cauchy(20_000).clip(-100, 100).astype(np.float32)
    entries, indices = codebook(values)
    uniform = np.round((values + 100) / 200 * 255) / 255 * 200 - 100
    assert np.mean((entries[indices] - values) ** 2) < np.mean((uniform - values) ** 2) / 2


def test_few_rows_are_their_own_entries() -> None:
    rows = np.random.default_rng(0).normal(size=(40, 9)).astype(np.float32)
    entries, labels = palette(rows, 40)
    np.testing.assert_array_equal(entries[labels], rows)


@pytest.mark.parametrize("size", [1, 2, 17, 300])
def test_entries_are_no_more_than_allowed_and_the_rows_nearest(size: int) -> None:
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(3_000, 9)).astype(np.float32) ** 3
    entries, labels = palette(rows, size)
    assert 1 <= len(entries) <= size and labels.min() >= 0 and labels.max() < len(entries)
    error = np.mean((entries[labels] - rows) ** 2)
    drawn = rows[rng.choice(len(rows), size, replace=False)]
    drawn_error = np.mean(((rows[:, None] - drawn[None]) ** 2).sum(axis=2).min(axis=1)) / 9
    assert error < drawn_error  # than rows that are only drawn
    if size == 1:
        np.testing.assert_allclose(entries[0], rows.mean(axis=0), atol=1e-4)


def test_equal_rows_have_one_entry() -> None:
    rows = np.repeat(np.eye(4, dtype=np.float32), 50, axis=0)
    entries, labels = palette(rows, 100)
    np.testing.assert_allclose(entries[labels], rows, atol=1e-6)
