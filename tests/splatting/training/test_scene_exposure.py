"""A scene whose photos differ in exposure is shown with one in which it is not burnt out."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest
import torch
from torch import Tensor

from fastsplat.service.common.progress import silent
from fastsplat.service.scene.artefact.scene import Gaussians
from fastsplat.service.splatting.exposure.photometric import correct, to_light, zero_mean
from fastsplat.service.splatting.exposure.scene_exposure import display_ev, exposed
from fastsplat.service.splatting.gaussians import color_parameters, splats_of
from fastsplat.service.splatting.training.train import train
from fastsplat.service.splatting.training_settings import TrainingSettings
from fastsplat.service.splatting.training_views import TrainingView, load_views, render_frame
from tests.splatting.training.conftest import exposed as photographed
from tests.splatting.training.conftest import repainted


def _ev(exposure: float) -> Tensor:
    return torch.tensor([exposure, 0.0, 0.0])


@pytest.fixture(scope="module")
def scene(world) -> Gaussians:
    settings = TrainingSettings(iterations=150, time_budget_s=None, max_gaussians=250, evaluations=0, held_out_every=0)
    return train(*world, settings, silent).gaussians


@pytest.fixture(scope="module")
def views(world) -> tuple[TrainingView, ...]:
    capture, truth = world
    return load_views(capture, truth, tuple(range(len(capture.views))), 64, (1.0,))


def _image(parameters: Mapping[str, Tensor], view: TrainingView) -> Tensor:
    degree = int((1 + parameters["sh_rest"].shape[1]) ** 0.5) - 1
    return render_frame(parameters, splats_of(parameters), view, view.frames[-1], degree=degree, backend="cpu").image


def _photographed(
    parameters: Mapping[str, Tensor], views: tuple[TrainingView, ...], corrections: Tensor
) -> tuple[TrainingView, ...]:
    """The views with photos of the scene itself, by those corrections, cut off at white and of 8 bits."""
    new_views = []
    for view, correction in zip(views, corrections, strict=True):
        image = correct(_image(parameters, view), correction).clamp(0, 1)
        rgb = (image * 255).round().to(torch.uint8)
        new_views.append(dataclasses.replace(view, frames=(dataclasses.replace(view.frames[-1], rgb=rgb),)))
    return tuple(new_views)


def test_an_exposed_scene_has_the_light_of_its_pictures_multiplied(scene, views) -> None:
    for ev in (-0.8, 0.4):
        darker = color_parameters(exposed(scene, _ev(ev)))
        for view in views[:3]:
            image = _image(color_parameters(scene), view)
            expected = correct(image, _ev(ev))
            difference = (_image(darker, view) - expected).abs()[image.amin(dim=2) > 0.1]
            assert difference.mean() < 0.004
    assert exposed(scene, _ev(0.0)) is scene


def test_a_scene_is_darkened_as_far_as_photos_show_it_below_white_and_no_further(scene, views) -> None:
    bright = exposed(scene, _ev(1.5))
    parameters = color_parameters(bright)
    burnt = torch.stack([_image(parameters, view) for view in views]).amax(dim=3)
    assert (burnt > 1).float().mean() > 0.05, "the case: much of it is brighter than white"
    dark = torch.full((12, 1), -2.0) * torch.tensor([1.0, 0.05, -0.05])
    photos = _photographed(parameters, views, dark)
    ev = display_ev(parameters, photos, dark, "cpu")
    assert -2 < ev < -0.2
    display = color_parameters(exposed(bright, _ev(ev)))
    share = float((torch.stack([_image(display, view) for view in views]).amax(dim=3) > 1.002).float().mean())
    assert share < 0.03
    # In photos of the scene's own exposure the same surfaces are white: nothing is known that could be shown.
    unknown = torch.zeros(12, 3)
    assert display_ev(parameters, _photographed(parameters, views, unknown), unknown, "cpu") == 0
    # A photo that is taken to be far darker than it is makes the scene no darker.
    plain = color_parameters(exposed(scene, _ev(-0.5)))
    photos = _photographed(plain, views, torch.zeros(12, 3))
    mistaken = torch.zeros(12, 3)
    mistaken[4, 0] = -5.0
    assert display_ev(plain, photos, mistaken, "cpu") == display_ev(plain, photos, torch.zeros(12, 3), "cpu")


def test_a_trained_scene_is_not_burnt_out_by_the_exposure_of_most_of_its_photos(
    world, views, quick: Callable[..., TrainingSettings], tmp_path: Path
) -> None:
    evs = [1.2 if index % 3 else -0.6 for index in range(12)]  # two photos of three overexposed, the others dark
    capture = repainted(world[0], tmp_path, lambda index, pixels: photographed(pixels, _ev(evs[index])))
    trained = train(capture, world[1], quick(iterations=300, held_out_every=0), silent)
    corrections = torch.tensor(list(trained.photometric.values()))
    assert torch.allclose(corrections, zero_mean(corrections), atol=1e-6)
    ev = trained.quality["exposure_ev"]
    assert -1.2 < ev < -0.1
    parameters = color_parameters(trained.gaussians)
    above = torch.stack([_image(parameters, view) for view in views]).amax(dim=3)
    assert float((above > 1).float().mean()) < 0.05
    raised = color_parameters(exposed(trained.gaussians, _ev(-ev)))
    burnt = torch.stack([_image(raised, view) for view in views]).amax(dim=3)
    assert float((burnt > 1).float().mean()) > 0.05, "without it, much would be"
    assert to_light(above.quantile(0.9)) > 0.3, "nor is it dark"
    plain = train(*world, quick(iterations=20, held_out_every=0, photometric="off"), silent)
    assert "exposure_ev" not in plain.quality
