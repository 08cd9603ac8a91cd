"""Regions are grouped as a dense matrix of overlaps would group them, in far less memory."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from fastsplat.service.splatting.labels import region_groups
from fastsplat.service.splatting.labels.region_groups import greedy_groups, lift_regions, one_piece_each, overlaps_of
from fastsplat.service.splatting.raster.image_formation import LabelSums

Region = tuple[int, int]  # view and region number, 1 the first


def group_regions(sums: Iterable[LabelSums], counts: Sequence[int], overlap: float = 0.5) -> list[tuple[Region, ...]]:
    """Groups as discovery makes them, of regions that do not overlap in their view."""
    overlaps = overlaps_of(
        lift_regions(view_sums, one_piece_each(count, view_sums)) for view_sums, count in zip(sums, counts, strict=True)
    )
    regions = [(view, region) for view, count in enumerate(counts) for region in range(1, count + 1)]
    groups = greedy_groups(overlaps, overlaps.agreement(overlap), overlap)
    return [tuple(regions[row] for row in members) for members in groups]


def made_sums(
    views: int, regions: int, gaussians: int, seed: int, *, seen: float = 0.7, slips: float = 0.1
) -> Iterator[LabelSums]:
    """Views that see part of the Gaussians, number objects by themselves, and err in some."""
    rng = np.random.default_rng(seed)
    obj = rng.integers(0, regions + 1, gaussians)  # 0: no object
    for _ in range(views):
        number = np.concatenate([[0], rng.permutation(regions) + 1])
        visible = rng.random(gaussians) < seen
        slipped = rng.random(gaussians) < slips
        label = number[np.where(slipped, rng.integers(0, regions + 1, gaussians), obj)]
        stray_label = rng.integers(0, regions + 1, gaussians)
        two = visible & (rng.random(gaussians) < slips) & (stray_label != label)
        rows = np.concatenate([np.flatnonzero(visible), np.flatnonzero(two)])
        labels = np.concatenate([label[visible], stray_label[two]])
        weights = rng.integers(1, 9, len(rows)).astype(np.float64)  # with 1, 2, 4 or 8 views every sum is exact
        order = np.lexsort((labels, rows))
        starts = np.concatenate([[0], np.cumsum(np.bincount(rows, minlength=gaussians))])
        yield LabelSums(
            torch.from_numpy(starts), torch.from_numpy(labels[order].astype(np.int32)), torch.from_numpy(weights[order])
        )


def dense_groups(sums: Sequence[LabelSums], counts: Sequence[int], overlap: float = 0.5) -> list[tuple[Region, ...]]:
    """The oracle: matrices of regions × Gaussians and of regions × regions."""
    pairs = [(view, region) for view, count in enumerate(counts) for region in range(1, count + 1)]
    if not pairs:
        return []
    owner = np.array([view for view, _ in pairs])
    similarity = dense_similarity(sums, pairs)
    np.fill_diagonal(similarity, 1.0)
    agreement = np.zeros(len(pairs))
    for view in np.unique(owner):
        best = similarity[:, owner == view].max(axis=1)
        agreement += np.where(best > overlap, best, 0.0)
    free, groups = np.ones(len(pairs), np.bool_), []
    while free.any():
        first = int(np.argmax(np.where(free, agreement, -1.0)))
        members = np.flatnonzero(free & (similarity[first] > overlap))
        joined = np.flatnonzero(free & (similarity[members].mean(axis=0) > overlap))
        members = joined if first in joined else members
        free[members] = False
        groups.append(tuple(pairs[row] for row in members))
    return groups


def dense_similarity(sums: Sequence[LabelSums], pairs: Sequence[Region]) -> np.ndarray:
    """[P, P] intersection over union; 0 below a tenth, and where one view sees too little of the other's region."""
    count = len(sums[0].starts) - 1
    seen = np.zeros((len(sums), count), np.float32)
    inside = np.zeros((len(pairs), count), np.float32)
    place = {pair: row for row, pair in enumerate(pairs)}
    for view, view_sums in enumerate(sums):
        rows = np.repeat(np.arange(count), np.diff(view_sums.starts.numpy()))
        labels, weights = view_sums.labels.numpy(), view_sums.sums.numpy()
        seen[view] = np.bincount(rows, weights, count)
        most = weights > 0.5 * seen[view, rows]
        for region in np.unique(labels[most]):
            if (view, region) in place:
                inside[place[view, int(region)], rows[most & (labels == region)]] = 1
    size = seen.mean(axis=0)
    visible = (seen > 0.05).astype(np.float32)
    owner = np.array([view for view, _ in pairs])
    inside *= visible[owner]
    weighted = inside * size
    common = weighted @ inside.T
    seen_by_other = (weighted @ visible.T)[:, owner]
    union = seen_by_other + seen_by_other.T - common
    whole = np.maximum(weighted.sum(axis=1, keepdims=True), 1e-12)
    enough = (seen_by_other / whole > 0.3) & ((seen_by_other / whole).T > 0.3)
    overlap = np.where(enough, common / np.maximum(union, 1e-12), 0.0).astype(np.float64)
    return np.where(overlap >= 0.1, overlap, 0.0)


@settings(max_examples=60, derandomize=True)
@given(
    st.sampled_from([1, 2, 4, 8]), st.integers(1, 7), st.integers(1, 120), st.integers(0, 10**6),
    st.floats(0.1, 1.0), st.floats(0.0, 0.5), st.sampled_from([1, 3, 64]),
)  # fmt: skip
def test_groups_are_those_of_the_dense_matrices(views, regions, gaussians, seed, seen, slips, rows) -> None:
    sums = list(made_sums(views, regions, gaussians, seed, seen=seen, slips=slips))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(region_groups, "_ROWS", rows)
        groups = group_regions(iter(sums), [regions] * views)
    assert groups == dense_groups(sums, [regions] * views)
    assert sorted(region for group in groups for region in group) == [
        (view, region) for view in range(views) for region in range(1, regions + 1)
    ]


def test_views_without_regions_and_regions_without_gaussians() -> None:
    sums = list(made_sums(4, 3, 50, 0))
    counts = [3, 0, 5, 3]  # two regions of the third view cover nothing
    assert group_regions(sums, counts) == dense_groups(sums, counts)
    assert group_regions(sums, [0] * 4) == []
