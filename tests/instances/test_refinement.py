"""Masks are lifted in one pass, objects take those that they match, and Gaussians count the masks' pixels."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from fastsplat.service.instances.discovery.lifting import image_pieces, lift_masks
from fastsplat.service.instances.discovery.ownership import NOBODY
from fastsplat.service.instances.discovery.refinement import UNKNOWN, MaskedView, refined_membership, repainted
from fastsplat.service.instances.discovery_settings import DiscoverySettings
from fastsplat.service.perception.results import ViewMasks
from fastsplat.service.scene.objects.label_evidence import posterior
from fastsplat.service.splatting.gaussians import splats_of
from fastsplat.service.splatting.raster.rendering import accumulate_weights
from fastsplat_contract.geometry.camera import Camera
from tests.instances.known_objects import gaussians_at, grid
from tests.instances.made_room import Room

SETTINGS = DiscoverySettings(min_weight_px=5)
SIDE = 40


def _square(top: int, left: int, side: int) -> np.ndarray:
    mask = np.zeros((SIDE, SIDE), np.bool_)
    mask[top : top + side, left : left + side] = True
    return mask


def test_edges_come_from_the_masks() -> None:
    """A cup on a table, drawn a little to the side of its mask; the table's mask may go on below the cup."""
    cup, table = _square(12, 12, 10), _square(4, 4, 30)
    id_map = np.where(_square(13, 12, 10), 2, np.where(_square(5, 5, 28), 1, 0))
    for table_mask in (table, table & ~cup):
        result = repainted(id_map, np.stack([table_mask, cup]), min_overlap=0.5)
        assert (result[cup] == 2).all() and (result[~table] == 0).all()
        assert (result[table_mask & ~cup] == 1).all()


def test_what_its_mask_leaves_out_is_unknown() -> None:
    id_map = _square(10, 10, 12).astype(int)
    result = repainted(id_map, _square(10, 10, 11)[None], min_overlap=0.5)
    assert set(np.unique(result)) == {UNKNOWN, 0, 1}
    assert ((result == UNKNOWN) == (_square(10, 10, 12) & ~_square(10, 10, 11))).all()


@given(st.integers(0, 2**32 - 1), st.integers(1, 6))
def test_without_masks_that_match_and_with_exact_ones_all_stays_as_drawn(seed: int, objects: int) -> None:
    rng = np.random.default_rng(seed)
    id_map = np.kron(rng.integers(0, objects + 1, (5, 5)), np.ones((8, 8), int))
    none = np.zeros((0, SIDE, SIDE), np.bool_)
    strangers = np.stack([_square(0, 0, 3), _square(20, 20, 2)])
    exact = np.stack([id_map == obj for obj in range(1, objects + 1)])
    for masks, min_overlap in ((none, 0.5), (strangers, 0.9), (exact, 0.5)):
        assert (repainted(id_map, masks, min_overlap=min_overlap) == id_map).all()


def _views(room: Room) -> list[MaskedView]:
    views = []
    for view, truth in zip(room.capture.views, room.maps, strict=True):
        height, width = truth.shape
        masks = np.stack([truth == number for number in range(1, 5)]).reshape(4, -1)
        proposals = ViewMasks(np.packbits(masks, axis=1), np.ones(4, np.float32), width, height, 4)
        views.append(MaskedView(view.posed, proposals))
    return views


def _right(owner: np.ndarray, room: Room, size: np.ndarray) -> float:
    return float(size[owner == room.owner].sum() / size.sum())


@settings(max_examples=5)
@given(st.integers(0, 2**32 - 1))
def test_wrong_owners_are_put_right_by_the_pixels(room: Room, seed: int) -> None:
    """A tenth of the Gaussians is given to somebody else, or to nobody."""
    rng = np.random.default_rng(seed)
    owners = room.owner.astype(np.int32)
    wrong = rng.random(len(owners)) < 0.1
    owners[wrong] = rng.integers(NOBODY, 4, wrong.sum())
    size = np.ones(len(owners), np.float32)
    shares = np.where(owners == NOBODY, 0, 1).astype(np.float32)
    results = []
    for rounds in (0, 2):
        bounds = SETTINGS.model_copy(update={"refinement_rounds": rounds})
        evidence = refined_membership(owners, shares, room.gaussians, _views(room), size, bounds)
        results.append(posterior(evidence, 5).classes - 1)
    assert (results[0] == owners).all()
    seen = np.ones(len(owners)) * (room.gaussians.means[:, 2] >= 0)  # upper halves of the balls, and the floor
    assert _right(results[1], room, seen) > _right(owners, room, seen)
    assert _right(results[1], room, seen) > 0.97


def test_pixels_without_content_say_nothing_and_owners_stay(room: Room, tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "valid.png"), np.zeros((72, 96), np.uint8))
    views = [replace(view, valid_path=tmp_path / "valid.png") for view in _views(room)]
    owners, shares = room.owner.astype(np.int32), np.ones(len(room.owner), np.float32)
    evidence = refined_membership(owners, shares, room.gaussians, views, shares, SETTINGS)
    assert (posterior(evidence, 5).classes - 1 == owners).all()


def test_nobody_owns_nothing(room: Room) -> None:
    owners, shares = np.full(len(room.owner), NOBODY, np.int32), np.zeros(len(room.owner), np.float32)
    evidence = refined_membership(owners, shares, room.gaussians, _views(room), shares, SETTINGS)
    assert (posterior(evidence, 1).classes == 0).all()


def test_holes_that_no_mask_fills_belong_to_what_is_around_them() -> None:
    """Grouping leaves a hole in a sheet, and no view says anything: the sheet has it, and owners stay."""
    gaussians = gaussians_at(grid(1.0, 1.0, 0.1))
    owners, hole = np.zeros(len(gaussians), np.int32), 44
    owners[hole], owners[:10] = NOBODY, 1
    size = np.ones(len(gaussians), np.float32)
    evidence = refined_membership(owners, np.ones(len(gaussians), np.float32), gaussians, [], size, SETTINGS)
    after = posterior(evidence, 3).classes - 1
    assert after[hole] == 0
    np.testing.assert_array_equal(np.delete(after, hole), np.delete(owners, hole))


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
