"""Photos that join a finished scene: what they do not show stays to the bit; Gaussians are made where nothing was."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from fastsplat.service.capture.types import Capture
from fastsplat.service.common.dictionary import Dictionary
from fastsplat.service.common.progress import silent
from fastsplat.service.perception.types import Labelling
from fastsplat.service.scene.types import Gaussians
from fastsplat.service.splatting.continuation import Continued, continuation_settings
from fastsplat.service.splatting.gaussians import color_parameters
from fastsplat.service.splatting.joining import born_gaussians, join_photos
from fastsplat.service.splatting.photometric import correct
from fastsplat.service.splatting.pruning import max_contribution
from fastsplat.service.splatting.quality import measure_views
from fastsplat.service.splatting.settings import TrainingSettings
from fastsplat.service.splatting.train import train
from fastsplat.service.splatting.training_views import load_views
from fastsplat_contract.camera import Camera, PosedCamera
from tests.splatting.train.conftest import MakeWorld

_SETTINGS = TrainingSettings(
    iterations=150, time_budget_s=None, max_gaussians=500, max_side=64, evaluations=0, held_out_every=0
)
_UNLABELED = Labelling(Dictionary(()), ())
_NOWHERE = np.zeros((0, 3))
_FIELDS = ("means", "quats", "log_scales", "logit_opacities", "sh")


def _trained(capture: Capture, views: int) -> Gaussians:
    return train(replace(capture, views=capture.views[:views]), _UNLABELED, _SETTINGS, silent).gaussians


def _joined(scene: Gaussians, capture: Capture, names: list[str], steps: int) -> Continued:
    settings = continuation_settings(_SETTINGS, scene, steps=steps, hold_out=False)
    return join_photos(scene, capture, names, settings, silent, places=_NOWHERE)


def _without_the_ball(scene: Gaussians) -> Gaussians:
    away = np.linalg.norm(scene.means - np.array([-0.4, 0.1, 0.3], np.float32), axis=1) > 0.4
    return Gaussians(**{name: array[away] for name, array in vars(scene).items()})


def _psnr(scene: Gaussians, capture: Capture, number: int) -> float:
    return measure_views(color_parameters(scene), load_views(capture, _UNLABELED, (number,), 64, (1.0,)), "cpu")["psnr"]


def _shown(scene: Gaussians, capture: Capture, number: int) -> np.ndarray:
    (view,) = load_views(capture, _UNLABELED, (number,), 64, (1.0,))
    return max_contribution(scene, [(view.viewmat, view.frames[-1].camera)])


def _narrow(capture: Capture, number: int, tmp_path: Path) -> Capture:
    """The capture whose view of this number shows the left half of what it showed."""
    view = capture.views[number]
    camera = view.posed.camera
    with Image.open(view.image_path) as image:
        half = image.crop((0, 0, camera.width // 2, camera.height))
    half.save(tmp_path / view.posed.name)
    small = Camera(camera.width // 2, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)
    posed = PosedCamera(small, view.posed.world_from_camera, view.posed.name)
    views = list(capture.views)
    views[number] = replace(view, posed=posed, image_path=tmp_path / view.posed.name)
    return replace(capture, views=tuple(views))


def test_what_a_photo_does_not_show_stays_to_the_bit(make_world: MakeWorld, tmp_path: Path) -> None:
    capture = _narrow(make_world(8)[0], 7, tmp_path)
    scene = _trained(capture, 7)
    name = capture.views[7].posed.name
    continued = _joined(scene, capture, [name], 40)
    changed, after = continued.changed, continued.trained.gaussians
    assert changed is not None and len(changed) == len(after) >= len(scene)
    shown = _shown(scene, capture, 7) >= 1
    count = len(scene)
    assert np.array_equal(changed[:count], shown) and changed[count:].all()
    assert 0 < shown.sum() < count
    for field in _FIELDS:
        before, same = getattr(scene, field), getattr(after, field)[:count]
        assert np.array_equal(before[~shown], same[~shown]), field
        assert not np.array_equal(before[shown], same[shown]), field
    assert np.array_equal(continued.origins[:count], np.arange(count))
    assert (continued.origins[count:] < count).all()


def test_where_nothing_was_gaussians_are_made_and_the_photos_are_reproduced(make_world: MakeWorld) -> None:
    capture, _ = make_world(8)
    scene = _without_the_ball(_trained(capture, 8))
    new = [1, 5]
    views = load_views(capture, _UNLABELED, tuple(new), 64, (1.0,))
    # Nothing is behind a part of the scene's own floor, so that the photos of the gap show less than half of anything.
    away = scene.means[:, 0] > -0.2
    gap = Gaussians(**{name: array[away] for name, array in vars(scene).items()})
    born, nearest = born_gaussians(gap, views, np.ones(len(gap), np.bool_), 10_000, _SETTINGS, _NOWHERE)
    assert len(born) > 10 and np.isfinite(born.means).all() and (nearest < len(gap)).all()
    ahead = born.means @ views[0].viewmat.numpy()[2, :3] + views[0].viewmat.numpy()[2, 3]
    assert (ahead > 0).all()
    few, _ = born_gaussians(gap, views, np.ones(len(gap), np.bool_), 7, _SETTINGS, _NOWHERE)
    assert len(few) == 7
    names = [capture.views[number].posed.name for number in new]
    continued = _joined(gap, capture, names, 150)
    after = continued.trained.gaussians
    assert len(after) > len(gap)
    for number in (1, 3, 5):  # the third did not join: it shows the same from elsewhere
        assert _psnr(after, capture, number) > _psnr(gap, capture, number) + 1, number


def test_what_photos_agree_on_is_made_where_it_is_nearer_than_the_scene_and_nowhere_else(make_world: MakeWorld) -> None:
    capture, _ = make_world(8)
    scene = _trained(capture, 8)
    (view,) = load_views(capture, _UNLABELED, (2,), 64, (1.0,))
    camera, rows = view.frames[-1].camera, np.ones(len(scene), np.bool_)
    pose = capture.views[2].posed.world_from_camera
    ray = pose[:3, :3] @ camera.rays(np.array([camera.cx]), np.array([camera.cy]))[0]
    near, far = (pose[:3, 3] + away * ray for away in (0.3, 50.0))
    assert len(born_gaussians(scene, (view,), rows, 100, _SETTINGS, np.stack([far]))[0]) == len(
        born_gaussians(scene, (view,), rows, 100, _SETTINGS, _NOWHERE)[0]
    )
    born, _ = born_gaussians(scene, (view,), rows, 100, _SETTINGS, np.stack([near, near + 0.01 * ray]))
    off = np.linalg.norm(born.means - near, axis=1)
    assert (off < 0.3 * 2 / camera.fx).sum() == 1
    settings, names = continuation_settings(_SETTINGS, scene, steps=1, hold_out=False), [capture.views[2].posed.name]
    counts = [
        len(join_photos(scene, capture, names, settings, silent, places=places).trained.gaussians)
        for places in (np.stack([near]), _NOWHERE)
    ]
    assert counts[0] == counts[1] + 1


def test_what_no_photo_of_before_shows_begins_nearly_clear(make_world: MakeWorld, tmp_path: Path) -> None:
    whole, _ = make_world(8)
    scene = _trained(whole, 8)
    capture = _narrow(replace(whole, views=whole.views[:2]), 0, tmp_path)
    old, new = (_shown(scene, capture, each) for each in (0, 1))
    unknown, known = (new >= 1) & (old < 0.01), (new >= 1) & (old > 0.02)
    after = _joined(scene, capture, [capture.views[1].posed.name], 1).trained.gaussians.logit_opacities[: len(scene)]
    assert unknown.sum() > 10 and known.sum() > 10
    assert (after[unknown] < -3).all() and (after[known] > scene.logit_opacities[known] - 0.5).all()


def test_a_scene_that_nothing_of_is_seen_gets_no_gaussians(make_world: MakeWorld) -> None:
    capture, _ = make_world(3)
    scene = _trained(capture, 3)
    views = load_views(capture, _UNLABELED, (0,), 64, (1.0,))
    made, nearest = born_gaussians(scene, views, np.zeros(len(scene), np.bool_), 100, _SETTINGS, _NOWHERE)
    assert len(made) == len(nearest) == 0


def test_photos_of_another_exposure_do_not_change_the_scenes(make_world: MakeWorld, tmp_path: Path) -> None:
    capture, _ = make_world(8)
    scene = _trained(capture, 8)
    with Image.open(capture.views[7].image_path) as image:
        pixels = torch.from_numpy(np.asarray(image).astype(np.float32) / 255)
    darker = correct(pixels, torch.tensor([-0.8, 0.0, 0.0])).clamp(0, 1)
    Image.fromarray((darker * 255).round().byte().numpy()).save(tmp_path / "dark.png")
    other = replace(capture, views=(*capture.views[:7], replace(capture.views[7], image_path=tmp_path / "dark.png")))
    continued = _joined(scene, other, [capture.views[7].posed.name], 80)
    for number in (0, 7):  # by the photos as they were
        assert _psnr(continued.trained.gaussians, capture, number) > _psnr(scene, capture, number) - 0.5
    off = continuation_settings(_SETTINGS, scene, steps=80, hold_out=False).model_copy(update={"photometric": "off"})
    as_sent = join_photos(scene, other, [capture.views[7].posed.name], off, silent, places=_NOWHERE)
    assert _psnr(as_sent.trained.gaussians, capture, 7) < _psnr(continued.trained.gaussians, capture, 7) - 1


def test_the_same_photos_give_the_same_scene(make_world: MakeWorld) -> None:
    capture, _ = make_world(6)
    scene = _trained(capture, 5)
    first, second = (_joined(scene, capture, [capture.views[5].posed.name], 20) for _ in range(2))
    for field in _FIELDS:
        assert np.array_equal(getattr(first.trained.gaussians, field), getattr(second.trained.gaussians, field))
