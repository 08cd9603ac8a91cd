"""A piece that is pointed at in one view: which answer of the segmenter is meant, and which Gaussians it is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import cv2
import numpy as np
import pytest

from fastsplat.service.instances.prompt_answers import PicturePrompt, matching_mask, prompted_mask
from fastsplat.service.instances.prompted_pieces import PromptedScene, find_piece
from fastsplat.service.perception.results import MaskLogits, Prompts
from fastsplat.service.scene.artefact.scene import Gaussians
from fastsplat.service.splatting.gaussians import splats_of
from fastsplat.service.splatting.raster.rendering import rasterize
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from tests.instances.known_objects import gaussians_at, grid
from tests.query.box_scenes import look

_SIDE = 64
_NONE = np.zeros((0, 2))


def _disk(x: float, y: float, radius: float) -> np.ndarray:
    rows, columns = np.mgrid[:_SIDE, :_SIDE]
    return (columns - x) ** 2 + (rows - y) ** 2 <= radius**2


def _answer(*masks: np.ndarray, quality: Sequence[float] = ()) -> MaskLogits:
    logits = np.where(np.stack(masks), 8.0, -8.0).astype(np.float32)[None]
    return MaskLogits(logits, np.array([quality or [0.9] * len(masks)], np.float32), (1.0, 1.0))


def _click(x: float, y: float, *background: tuple[float, float]) -> PicturePrompt:
    return PicturePrompt(np.array([[x, y]]), np.array(background, np.float64).reshape(-1, 2))


def test_of_a_part_an_object_and_a_group_the_object_is_meant() -> None:
    part, obj, neighbor = _disk(20, 30, 5), _disk(20, 30, 9), _disk(42, 30, 9)
    group = obj | neighbor
    ids = np.where(group, 7, 0)
    answer = _answer(part, obj, group, quality=(0.95, 0.9, 0.9))
    chosen = prompted_mask(answer, _click(20, 30), ids, ids == 7)
    np.testing.assert_array_equal(chosen, obj)
    # Who wants the part says what is beside it, or how large it is.
    chosen = prompted_mask(answer, _click(20, 30, (27.5, 30)), ids, ids == 7)
    np.testing.assert_array_equal(chosen, part)
    box = PicturePrompt(_NONE, _NONE, np.array([15.0, 25.0, 26.0, 36.0]))
    np.testing.assert_array_equal(prompted_mask(answer, box, ids, ids == 7), part)


def test_an_answer_that_leaves_the_object_is_not_its_piece() -> None:
    obj, beside = _disk(20, 30, 9), _disk(30, 30, 20)
    ids = np.where(obj, 7, 0)
    chosen = prompted_mask(_answer(_disk(20, 30, 5), beside), _click(20, 30), ids, ids == 7)
    np.testing.assert_array_equal(chosen, _disk(20, 30, 5))


def test_a_missing_object_is_not_made_of_whole_other_objects() -> None:
    obj, neighbor = _disk(20, 30, 9), _disk(42, 30, 9)
    answer = _answer(obj, obj | neighbor)
    np.testing.assert_array_equal(prompted_mask(answer, _click(20, 30), np.where(neighbor, 3, 0), None), obj)
    # Where nothing is known of the other, the larger answer is as good.
    chosen = prompted_mask(answer, _click(20, 30), np.zeros((_SIDE, _SIDE), int), None)
    np.testing.assert_array_equal(chosen, obj | neighbor)


def test_specks_are_no_answer() -> None:
    ids = np.full((_SIDE, _SIDE), 7)
    assert prompted_mask(_answer(_disk(20, 30, 1), _disk(0, 0, 0) & False), _click(20, 30), ids, ids == 7) is None


def test_a_view_that_shows_something_else_has_no_say() -> None:
    drawn = np.zeros((_SIDE, _SIDE, 3), np.float32)
    drawn[_disk(30, 30, 10), 0] = 1
    drawn[~_disk(30, 30, 10), 1] = 1
    known: Any = _Known()
    for mask, agrees in ((_disk(30, 30, 11), True), (_disk(30, 30, 20), False), (_disk(50, 50, 8), False)):
        again = matching_mask(known, partial(np.array, mask[None]), drawn)
        assert (again is not None) is agrees and (again is None or (again == mask).all())
    # What no view has seen yet is no contradiction.
    drawn[..., 2], drawn[..., 1] = drawn[..., 1], 0
    assert matching_mask(known, lambda: _disk(30, 30, 20)[None], drawn) is not None
    assert matching_mask(known, lambda: pytest.fail("embedded"), 0 * drawn) is None


class _Known:
    """Answers every prompt with the masks, bool [M, H, W], that it was told to be what it knows of the picture."""

    def mask_logits(self, embedding: np.ndarray, prompts: Prompts) -> MaskLogits:
        return _answer(*embedding)


def _ball(center: Sequence[float], count: int, radius: float, seed: int) -> np.ndarray:
    directions = np.random.default_rng(seed).normal(size=(count, 3))
    return np.asarray(center) + radius * directions / np.linalg.norm(directions, axis=1, keepdims=True)


def _rendering(gaussians: Gaussians, parts: Sequence[np.ndarray], posed: PosedCamera) -> np.ndarray:
    """bool [K, H, W]: where each part is what one sees most of."""
    import torch

    features = np.zeros((len(gaussians), len(parts)), np.float32)
    for number, rows in enumerate(parts):
        features[rows, number] = 1
    viewmat = torch.from_numpy(posed.camera_from_world().astype(np.float32))
    with torch.no_grad():
        image = rasterize(splats_of(gaussians, torch.from_numpy(features)), viewmat, posed.camera).image.numpy()
    return np.moveaxis(image, 2, 0) > 0.5


def test_what_a_mask_spills_onto_in_one_view_is_cut_off_by_the_others() -> None:
    # A ball before a wall; in the first view the ball's mask spills over its edge, onto the wall.
    wall = grid(1.0, 1.0, 0.03)[:, [2, 0, 1]] + np.array([0.13, 0.0, 0.1])
    gaussians = gaussians_at(np.concatenate([_ball((0.25, 0, 0.15), 300, 0.12, 0), wall]))
    ball, behind = np.arange(300), np.arange(300, len(gaussians))
    first, *other_cameras = [
        look((1.2 * np.cos(a), 1.2 * np.sin(a), 0.5), (0, 0, 0.1), f"{a:.1f}") for a in (0.0, 0.9, 1.8)
    ]
    masks = {posed.name: _rendering(gaussians, [ball, behind], posed)[:1] for posed in other_cameras}
    true, rest = _rendering(gaussians, [ball, behind], first)
    masks[first.name] = (true | ((cv2.dilate(true.astype(np.uint8), np.ones((5, 5))) > 0) & rest))[None]
    ids = np.where(masks[first.name][0], 7, 0)
    row, column = np.argwhere(true)[100]
    click = _click(column + 0.5, row + 0.5)
    known: Any = _Known()
    spilled, views = [], []
    for further in ([], other_cameras):
        scene = PromptedScene(gaussians, None, known, lambda posed: masks[posed.name], lambda found, to=further: to)
        piece = find_piece(scene, first, click, ids)
        assert np.isin(ball, piece.rows).all() and piece.views[0] is first
        spilled.append(int(np.isin(behind, piece.rows).sum()))
        views.append(len(piece.views))
    assert views[0] == 1 < views[1] and spilled[1] < 0.6 * spilled[0], (views, spilled)
    region = np.arange(len(gaussians)) < 350
    part = find_piece(replace(scene, region=region), first, click, ids)
    assert region[part.rows].all() and np.isin(ball, part.rows).all()


def test_where_nothing_is_segmented_no_gaussian_is_taken() -> None:
    gaussians = gaussians_at(_ball((0, 0, 0), 50, 0.1, 0))
    camera = Camera(_SIDE, _SIDE, 60.0, 60.0, 32.0, 32.0)
    pose = np.eye(4)
    pose[2, 3] = -1.0
    empty = np.zeros((1, _SIDE, _SIDE), np.bool_)
    known: Any = _Known()
    scene = PromptedScene(gaussians, None, known, lambda posed: empty, lambda found: ())
    piece = find_piece(scene, PosedCamera(camera, pose), _click(32, 32), np.zeros((_SIDE, _SIDE), int))
    assert len(piece.rows) == 0 and piece.views == ()
