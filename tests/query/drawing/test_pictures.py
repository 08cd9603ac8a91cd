"""Pictures: the colour map's order, overlays that touch the mask alone, PNG without loss."""

from __future__ import annotations

from io import BytesIO

import numpy as np
import pytest
from PIL import Image

from fastsplat.service.query.drawing.pictures import (
    named_overlay,
    objects_picture,
    overlay,
    png_bytes,
    relevancy_picture,
    turbo,
)
from fastsplat_contract.errors import InvalidInputError


def test_turbo_is_near_the_published_table() -> None:
    # Entries of Mikhailov's 256-colour table that are not among the interpolated ones.
    published = {
        4: (53, 30, 88),
        60: (47, 178, 244),
        100: (63, 246, 138),
        140: (195, 241, 52),
        196: (248, 114, 28),
        252: (133, 7, 2),
    }
    for index, colour in published.items():
        assert np.abs(turbo(np.array(index / 255)).astype(int) - colour).max() <= 3


def test_turbo_clamps_and_never_fails() -> None:
    values = np.array([[-1.0, 0.0, np.nan], [1.0, 7.0, np.inf]])
    colours = turbo(values)
    assert colours.shape == (2, 3, 3) and colours.dtype == np.uint8
    assert (colours[0] == colours[0, 0]).all() and (colours[1] == colours[1, 0]).all()


def test_overlay_touches_the_mask_alone() -> None:
    rng = np.random.default_rng(0)
    rgb = rng.integers(0, 256, (20, 30, 3), dtype=np.uint8)
    mask = rng.random((20, 30)) < 0.4
    before = rgb.copy()
    picture = overlay(rgb, mask)
    np.testing.assert_array_equal(rgb, before)
    np.testing.assert_array_equal(picture[~mask], rgb[~mask])
    np.testing.assert_array_equal(overlay(rgb, np.zeros_like(mask)), rgb)


def test_an_object_has_the_same_color_in_every_view_and_its_name_only_where_it_shows() -> None:
    rng = np.random.default_rng(1)
    rgb = rng.integers(0, 256, (120, 200, 3), dtype=np.uint8)
    rgb[...] = rgb.mean(axis=2, keepdims=True)
    ids = np.zeros((120, 200), dtype=np.uint16)
    ids[10:60, 10:90], ids[70:110, 20:160] = 2, 9
    unnamed, named = objects_picture(rgb, ids, {}), objects_picture(rgb, ids, {9: "mug", 4: "not in view"})
    assert np.abs(unnamed[ids == 0].astype(int) - rgb[ids == 0]).max() <= 1
    same = ids == 2
    np.testing.assert_array_equal(named[same], unnamed[same])
    assert (named[ids == 9] != unnamed[ids == 9]).any()
    other_ids = np.where(ids == 9, 0, ids).astype(np.uint16)  # the largest id leaves: the colors of the rest stay
    np.testing.assert_array_equal(objects_picture(rgb, other_ids, {})[same], unnamed[same])
    tints = [(unnamed[ids == number].astype(float) - 0.4 * rgb[ids == number]).mean(axis=0) for number in (2, 9)]
    assert np.abs(tints[0] - tints[1]).max() > 40


def test_a_named_overlay_tints_each_label_differently_and_writes_on_nothing_else() -> None:
    rgb = np.full((120, 200, 3), 90, dtype=np.uint8)
    label_ids = np.zeros((120, 200), dtype=np.uint16)
    label_ids[20:100, 10:90] = 3
    label_ids[20:100, 110:190] = 7
    mask = label_ids > 0
    mask[5:15, 10:40] = True  # of what has no name
    picture = named_overlay(rgb, mask, label_ids, [(7, "mug"), (3, "cup"), (9, "not in view")])
    np.testing.assert_array_equal(picture[~mask], rgb[~mask])
    inner = [tuple(picture[25, x]) for x in (15, 115)]
    assert inner[0] != inner[1] and (90, 90, 90) not in (*inner, tuple(picture[10, 25]))
    assert (picture[50:70, 30:70] == 0).all(axis=2).any(), "a name tag stands in the middle of its part"
    np.testing.assert_array_equal(named_overlay(rgb, label_ids < 0, np.zeros_like(label_ids), [(3, "cup")]), rgb)


def test_overlay_outlines_the_edge_and_not_the_inside() -> None:
    rgb = np.zeros((9, 9, 3), dtype=np.uint8)
    mask = np.zeros((9, 9), dtype=bool)
    mask[2:7, 2:7] = True
    white = (overlay(rgb, mask) == 255).all(axis=2)
    inside = np.zeros_like(mask)
    inside[3:6, 3:6] = True
    np.testing.assert_array_equal(white, mask & ~inside)


@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (2, 2)])
def test_tiny_images(shape: tuple[int, int]) -> None:
    rgb = np.zeros((*shape, 3), dtype=np.uint8)
    assert overlay(rgb, np.ones(shape, dtype=bool)).shape == rgb.shape
    assert relevancy_picture(rgb, np.ones(shape, dtype=np.float32)).shape == rgb.shape


@pytest.mark.parametrize("shape", [(4, 6, 3), (4, 6)])
def test_png_is_lossless(shape: tuple[int, ...]) -> None:
    image = np.random.default_rng(0).integers(0, 256, shape, dtype=np.uint8)
    np.testing.assert_array_equal(np.asarray(Image.open(BytesIO(png_bytes(image)))), image)


def test_wrong_shapes_are_refused() -> None:
    with pytest.raises(InvalidInputError):
        overlay(np.zeros((4, 6, 3), dtype=np.uint8), np.zeros((6, 4), dtype=bool))
    for bad in (np.zeros((4, 6, 2), dtype=np.uint8), np.zeros((4, 6), dtype=np.float32), np.zeros(4, dtype=np.uint8)):
        with pytest.raises(InvalidInputError):
            png_bytes(bad)
