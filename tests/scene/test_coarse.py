"""A large scene in fewer Gaussians: it covers as much, and a picture of it is nearly that of all."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fastsplat.service.query.drawing.scene_renderer import Renderer
from fastsplat.service.query.objects.labeled_objects import label_gaussians, labeled_objects
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.query.scene_index import CoarseView
from fastsplat.service.scene.artefact.scene import SH_C0, Scene
from fastsplat.service.scene.gaussians.coarse import coarse_scene
from fastsplat.service.scene.gaussians.scene_rows import scene_of_rows
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from tests.scenes import labelled_scene

_GAUSSIANS = 40_000
_MOST = 6_000
_VIEW = PosedCamera(Camera(96, 96, 100.0, 100.0, 48.0, 48.0), np.eye(4), "front")


def _floor(opacity: float = 3.0) -> Scene:
    """A wall of two colors and two objects before the camera, its rows from left to right."""
    rng = np.random.default_rng(1)
    means = np.column_stack([
        np.sort(rng.uniform(-1, 1, _GAUSSIANS)), rng.uniform(-1, 1, _GAUSSIANS), np.full(_GAUSSIANS, 3.0),
    ])  # fmt: skip
    left = means[:, 0] < 0
    colors = np.where(left[:, None], [0.8, 0.2, 0.1], [0.1, 0.3, 0.9])
    sh = np.zeros((_GAUSSIANS, 4, 3), np.float32)
    sh[:, 0] = (colors - 0.5) / SH_C0
    return labelled_scene(
        means, np.where(left, 1, 2), ("cup", "book"), scales=0.012, logit_opacities=opacity, sh=sh, cameras=[_VIEW]
    )


def test_a_small_scene_has_no_coarse_one() -> None:
    assert coarse_scene(_floor(), _GAUSSIANS) is None


@pytest.mark.parametrize("opacity", [3.0, -1.5])
def test_a_coarse_scene_has_about_as_many_gaussians_as_asked_and_looks_nearly_the_same(opacity: float) -> None:
    scene = _floor(opacity)
    coarse = coarse_scene(scene, _MOST)
    assert abs(len(coarse.gaussians) - _MOST) <= 0.02 * _MOST and coarse.gaussians.sh.shape[1] == 1
    again = coarse_scene(scene, _MOST)
    assert again is not None and np.array_equal(again.gaussians.means, coarse.gaussians.means)
    settings = QuerySettings()
    full = Renderer(scene, settings).colors(_VIEW).astype(float)
    drawn = Renderer(coarse, settings).colors(_VIEW).astype(float)
    some = Renderer(scene_of_rows(scene, np.arange(0, _GAUSSIANS, _GAUSSIANS // _MOST)), settings).colors(_VIEW)
    off, off_of_some = np.abs(drawn - full).mean(), np.abs(some - full).mean()
    assert full.mean() > 45 and off < 8 and off < 0.8 * off_of_some, (off, off_of_some)  # some stand for nobody else


def test_what_covers_most_stays_as_it_is() -> None:
    scene = _floor()
    log_scales = scene.gaussians.log_scales.copy()
    large = np.arange(0, _GAUSSIANS, 400)
    log_scales[large] = np.log(0.5)
    coarse = coarse_scene(replace(scene, gaussians=replace(scene.gaussians, log_scales=log_scales)), _MOST)
    large_mask = np.isclose(coarse.gaussians.log_scales, np.log(0.5)).all(axis=1)
    assert np.array_equal(coarse.gaussians.means[large_mask], scene.gaussians.means[large])
    assert np.array_equal(coarse.gaussians.logit_opacities[large_mask], scene.gaussians.logit_opacities[large])


def test_objects_are_where_they_are_in_full() -> None:
    plain = _floor()
    scene = replace(plain, objects=labeled_objects(plain, label_gaussians(plain)))
    coarse = coarse_scene(scene, _MOST)
    drawn = CoarseView(coarse, QuerySettings()).objects.map(_VIEW)
    full = Renderer(scene, QuerySettings()).id_map(_VIEW, scene.objects)
    assert set(np.unique(full)) >= {1, 2} and (drawn == full).mean() > 0.97
