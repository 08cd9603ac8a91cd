"""Objects of a known size, with Gaussians that lie off their surfaces."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fastsplat.service.query.measures.measuring import measure
from fastsplat.service.query.measures.object_extents import without_strays
from fastsplat.service.scene.artefact.scene import Scene
from fastsplat_contract.geometry.places import Place
from tests.query.box_scenes import BoxShell, orbit, scene_of
from tests.query.conftest import index_of

_SIZE = (0.4, 0.2, 0.3)
_COUNT = 4_000
_LEFT = BoxShell("left", (-0.5, 0.0, 0.0), _SIZE, count=_COUNT)
_RIGHT = BoxShell("right", (0.5, 0.0, 0.0), _SIZE, yaw=0.5, count=_COUNT)


def _strewn(share: float, seed: int = 0) -> tuple[Scene, np.ndarray]:
    """The two boxes, three meters off, with a share of their Gaussians some 8 cm off; and which these are."""
    scene = scene_of([_LEFT, _RIGHT], orbit(8, 2.5, 1.8))
    rng = np.random.default_rng(seed)
    off = rng.random(2 * _COUNT) < share
    means = (
        scene.gaussians.means
        + np.float32(3.0)
        + (rng.normal(0, 1, (2 * _COUNT, 3)) * np.where(off, 0.08, 0.002)[:, None]).astype(np.float32)
    )
    return replace(scene, gaussians=replace(scene.gaussians, means=means)), off


@pytest.mark.parametrize("share", [0.0, 0.01, 0.02])
def test_strays_change_neither_size_nor_distance(share: float) -> None:
    index = index_of(_strewn(share)[0])
    for obj in (1, 2):
        sides = measure(index, [Place(object_id=obj)], "1").sides
        assert sides[0].value >= sides[1].value
        for side, true in zip(sorted(sides), sorted(_SIZE), strict=True):
            assert side.value == pytest.approx(true, abs=0.025) and side.low <= true <= side.high
    between = measure(index, [Place(object_id=1), Place(object_id=2)], "1")
    assert between.distance is not None and between.center_distance is not None
    plain = measure(index_of(_strewn(0.0)[0]), [Place(object_id=1), Place(object_id=2)], "1")
    assert plain.distance is not None
    assert between.distance.value == pytest.approx(plain.distance.value, abs=0.025)
    assert between.center_distance.low <= 1.0 <= between.center_distance.high


def test_what_lies_off_is_left_out_and_the_surface_stays() -> None:
    scene, off = _strewn(0.02)
    rows = np.arange(_COUNT)
    surface_rows, thickness = without_strays(scene.gaussians, rows)
    assert 0 < thickness < 0.01 and (np.diff(surface_rows) > 0).all()
    stays = np.isin(rows, surface_rows)
    assert stays[~off[rows]].mean() > 0.98
    assert stays[off[rows]].mean() < 0.5  # the others happen to lie by a surface


def test_few_gaussians_are_all_kept() -> None:
    scene, _ = _strewn(0.5)
    surface_rows, thickness = without_strays(scene.gaussians, np.arange(20))
    assert len(surface_rows) == 20 and thickness == 0.0
