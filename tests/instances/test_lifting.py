"""Overlapping masks are lifted in one pass as if each had a pass of its own."""

from __future__ import annotations

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from fastsplat.service.instances.discovery.lifting import image_pieces, lift_masks
from fastsplat.service.splatting.gaussians import splats_of
from fastsplat.service.splatting.raster.rendering import accumulate_weights
from fastsplat_contract.geometry.camera import Camera
from tests.instances.known_objects import gaussians_at

CAMERA = Camera(40, 30, 40.0, 40.0, 20.0, 15.0)
VIEWMAT = torch.eye(4)


@given(st.integers(0, 12), st.integers(0, 2**32 - 1))
def test_pieces_make_up_the_masks_and_are_different(count: int, seed: int) -> None:
    masks = np.random.default_rng(seed).random((count, 9, 11)) < 0.4
    pieces, members = image_pieces(masks)
    assert (members[pieces].transpose(2, 0, 1) == masks).all()
    assert len(np.unique(members, axis=0)) == len(members)
    assert set(np.unique(pieces)) == set(range(len(members)))


@settings(max_examples=20)
@given(st.integers(1, 8), st.integers(0, 2**32 - 1), st.booleans())
def test_a_gaussian_is_inside_masks_that_have_more_than_half_of_it(count: int, seed: int, bounded: bool) -> None:
    rng = np.random.default_rng(seed)
    points = rng.uniform([-1, -0.8, 1.5], [1, 0.8, 3.0], (80, 3))
    splats = splats_of(gaussians_at(points, 0.06))
    masks = np.zeros((count, 30, 40), np.bool_)
    for mask in masks:
        top, left = rng.integers(0, 20), rng.integers(0, 28)
        mask[top : top + rng.integers(4, 12), left : left + rng.integers(4, 14)] = True
    valid = rng.random((30, 40)) < 0.7 if bounded else None
    counted = masks if valid is None else masks & valid
    everything = np.ones((30, 40), np.bool_) if valid is None else valid
    layers = np.concatenate([counted, everything[None]]).transpose(1, 2, 0).astype(np.float32)
    weights = accumulate_weights(splats, VIEWMAT, CAMERA, torch.from_numpy(layers.copy())).numpy()
    lifted = lift_masks(splats, VIEWMAT, CAMERA, masks, valid=valid)
    assert np.allclose(lifted.pixels, weights[:, -1], atol=1e-3)
    assert len(lifted) == count
    for number in range(count):
        rows = lifted.rows[lifted.starts[number] : lifted.starts[number + 1]]
        share = weights[:, number] / np.maximum(weights[:, -1], 1e-9)
        clear = (np.abs(share - 0.5) > 1e-3) & (np.abs(weights[:, -1] - 0.05) > 1e-3)
        expected = (share > 0.5) & (weights[:, -1] > 0.05)
        assert set(rows[clear[rows]]) == set(np.flatnonzero(expected & clear))


def test_a_view_without_masks_still_says_what_it_sees() -> None:
    splats = splats_of(gaussians_at(np.array([[0.0, 0.0, 2.0]]), 0.1))
    lifted = lift_masks(splats, VIEWMAT, CAMERA, np.zeros((0, 30, 40), np.bool_))
    assert len(lifted) == 0 and len(lifted.rows) == 0 and lifted.pixels[0] > 1
