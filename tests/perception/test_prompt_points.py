"""Points are prompted where nothing is explained, and in large masks, once a piece."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import label

from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.results import MaskLogits, Prompts
from fastsplat.service.perception.segmenters.mask_proposals import CutImage, open_points, propose_masks

NOWHERE = np.zeros((0, 2))


@given(st.integers(0, 2**32 - 1), st.integers(0, 24))
def test_points_lie_in_every_open_piece_and_nowhere_else(seed: int, most: int) -> None:
    answered = np.kron(np.random.default_rng(seed).random((4, 5)) < 0.5, np.ones((16, 16))).astype(bool)
    points = open_points(np.zeros(answered.shape, np.int64), answered, most)
    connected, count = label(~answered)
    prompted = connected[points[:, 1].astype(int), points[:, 0].astype(int)]
    assert len(points) <= most and prompted.all()
    if len(points) < most:
        assert set(prompted.tolist()) == set(range(1, count + 1))
    apart = np.linalg.norm(points[:, None] - points, axis=2)
    same = (prompted[:, None] == prompted) & ~np.eye(len(points), dtype=bool)
    assert (apart[same] >= 24).all()


@given(st.integers(6, 9), st.integers(12, 24), st.booleans())
def test_a_thin_hole_of_a_large_mask_is_prompted_once(width: int, length: int, upright: bool) -> None:
    """What lies on a table and is cut out of its mask; the prompt that found the table does not count for it."""
    table = np.ones((64, 96), np.bool_)
    shape = (length, width) if upright else (width, length)
    table[20 : 20 + shape[0], 40 : 40 + shape[1]] = False
    image = CutImage(table.shape)
    image.add(table[None])
    (point,) = open_points(image.pieces, image.answered(np.array([[10.5, 10.5]])), 8)
    assert not table[int(point[1]), int(point[0])]


@given(st.lists(st.tuples(st.integers(0, 40), st.integers(0, 40), st.integers(8, 40)), max_size=6))
def test_pieces_are_pixels_of_the_same_masks(squares: list[tuple[int, int, int]]) -> None:
    masks = np.zeros((len(squares), 48, 48), np.bool_)
    for mask, (top, left, side) in zip(masks, squares, strict=True):
        mask[top : top + side, left : left + side] = True
    image = CutImage((48, 48))
    image.add(masks[:2])
    image.add(masks[2:])
    sets = [tuple(column) for column in masks.reshape(len(masks), 48 * 48).T.tolist()]
    numbers = image.pieces.ravel().tolist()
    assert len(set(zip(sets, numbers, strict=True))) == len(set(sets)) == len(set(numbers))
    assert (image.pieces[~masks.any(axis=0)] == 0).all()


def test_a_small_mask_is_answered_and_a_large_one_is_not_until_it_is_prompted() -> None:
    bed, cup = np.zeros((2, 64, 64), np.bool_)
    bed[8:56, 8:56], cup[20:30, 20:30] = True, True
    image = CutImage((64, 64))
    image.add(np.stack([bed, cup]))
    assert image.answered(NOWHERE)[cup].all() and not image.answered(NOWHERE)[bed & ~cup].any()
    prompted = image.answered(np.array([[40.5, 40.5]]))
    assert prompted[bed].all() and not prompted[2:6].any()


class _DollOnBed:
    """Answers a point with the one of bed and doll that it lies on; background is answered with nothing."""

    def __init__(self) -> None:
        self.bed, self.doll = np.zeros((2, 64, 64), np.bool_)
        self.bed[30:60, 4:60], self.doll[4:30, 12:52] = True, True

    def mask_logits(self, embedding: None, prompts: Prompts) -> MaskLogits:
        """One answer to each prompt."""
        columns, rows = prompts.points[:, 0].astype(int).T
        doll, bed = self.doll[rows, columns, None, None], self.bed[rows, columns, None, None]
        masks = (doll & self.doll) | (bed & self.bed)
        logits = np.where(masks, 8.0, -8.0).astype(np.float32)[:, None]
        return MaskLogits(logits, np.full((len(rows), 1), 0.95, np.float32), (1.0, 1.0))


def test_a_box_that_has_two_objects_hides_neither() -> None:
    room = _DollOnBed()
    together = np.where(room.bed | room.doll, 8.0, -8.0).astype(np.float32)[None, None]
    answer = MaskLogits(together, np.array([[0.95]], np.float32), (1.0, 1.0))
    masks = propose_masks(room, None, answer, (64, 64), PerceptionSettings())
    proposals = masks.resized(64, 64)
    for true in (room.bed, room.doll, room.bed | room.doll):
        assert any((mask == true).all() for mask in proposals)
