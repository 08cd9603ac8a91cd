"""Places that photos agree on lie on the surfaces that they show, which nobody tells them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fastsplat.service.localization.agreed_places import agreed_places
from fastsplat_contract.camera import PosedCamera
from tests.localization.textured_room import looking, renderer, textured_room

_ANGLES = (-0.3, -0.1, 0.1, 0.3)
Photos = list[tuple[PosedCamera, np.ndarray]]


@pytest.fixture(scope="module")
def photos() -> Photos:
    drawn = renderer(textured_room())
    return [(posed, drawn.colors(posed)) for posed in map(looking, _ANGLES)]


def test_they_lie_on_what_the_photos_show(photos: Photos) -> None:
    places = agreed_places(photos)
    assert len(places) > 200
    off = np.abs(places).min(axis=1)  # the walls are where one coordinate is zero
    assert np.median(off) < 0.01 and np.quantile(off, 0.95) < 0.1


def test_the_frame_of_the_photos_is_that_of_the_places(photos: Photos) -> None:
    move = np.eye(4)
    move[:3, 3] = [3.0, -1.0, 0.5]
    moved = [(replace(posed, world_from_camera=move @ posed.world_from_camera), photo) for posed, photo in photos]
    np.testing.assert_allclose(agreed_places(moved), agreed_places(photos) + move[:3, 3], atol=1e-6)


def test_photos_that_show_nothing_alike_or_from_one_place_agree_on_nothing(photos: Photos) -> None:
    gray = (photos[1][0], np.full_like(photos[1][1], 128))
    assert agreed_places([]).shape == agreed_places(photos[:1]).shape == (0, 3)
    assert len(agreed_places([photos[0], gray])) == len(agreed_places([photos[0], photos[0]])) == 0
    wrong = [(photos[0][0], photos[0][1]), (looking(1.2), photos[1][1])]
    assert len(agreed_places(wrong)) < len(agreed_places(photos[:2])) / 5
