"""A run that goes astray is taken back, and says so; one that leads to no scene fails."""

from __future__ import annotations

from collections.abc import Callable
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from fastsplat.service.common.progress import silent
from fastsplat.service.jobs.create_scene import scene_facts
from fastsplat.service.scene.artefact.scene import SceneFacts
from fastsplat.service.settings import Settings
from fastsplat.service.splatting.exposure.photometric_training import CORRECTIONS
from fastsplat.service.splatting.state import GAUSSIAN_PARAMETERS, SplatState, new_state
from fastsplat.service.splatting.training import optimization
from fastsplat.service.splatting.training.densify import densify_if_due
from fastsplat.service.splatting.training.run_watch import RunWatch, return_warnings
from fastsplat.service.splatting.training.train import train
from fastsplat.service.splatting.training_settings import TrainingSettings
from fastsplat.service.splatting.training_views import TrainingView, load_views
from fastsplat.workers.kinds.create_scene import load_trained, save_trained
from fastsplat_contract.errors import CancelledError, TrainingDivergedError
from tests.splatting.training.conftest import repainted, same_run, stopping_at


@pytest.fixture
def views(world) -> tuple[TrainingView, ...]:
    return load_views(*world, tuple(range(12)), 64, (1.0,))


def _watched(views: tuple[TrainingView, ...], losses: Callable[[int], float], steps: int) -> SplatState:
    """A run of so many steps of these losses, in which every step moves the Gaussians by one."""
    state = new_state({name: torch.full((200, 3), 3.0) for name in GAUSSIAN_PARAMETERS})
    state.parameters["logit_opacities"] = torch.full((200,), 3.0)
    watch = RunWatch(views, torch.zeros(50, 3), TrainingSettings())
    for _ in range(steps):
        state.iteration += 1
        watch.after_step(state, torch.tensor(losses(state.iteration)), 0)
        state.parameters["codes"].detach().add_(1.0)
    return state


def test_a_rise_over_hundreds_of_steps_leads_back_and_not_the_order_of_the_views(views) -> None:
    assert return_warnings(_watched(views, lambda step: 0.1 + 0.05 * (step % 12) + 0.1 * (step % 97 == 0), 2_000)) == ()
    risen = _watched(views, lambda step: 0.1 + 0.0002 * max(0, step - 540), 870)
    assert len(return_warnings(risen)) == 1 and CORRECTIONS not in risen.parameters
    assert risen.parameters["codes"][0, 0] < 3 + 870 - 200, "the Gaussians are those of before the rise"
    rising = _watched(views, lambda step: 0.1 * 1.005**step, 3_000)
    assert len(return_warnings(rising)) == 3 and CORRECTIONS in rising.parameters


def _gathering(views: tuple[TrainingView, ...], at: int) -> Callable[..., None]:
    """Densification that once puts every second Gaussian, opaque, before a camera."""

    def densify(state: SplatState, *args: Any) -> None:
        densify_if_due(state, *args)
        if state.iteration == at:
            for row, view in zip(range(0, state.count, 2), cycle(views), strict=False):
                state.parameters["means"].detach()[row] = view.position + 0.15 * view.viewmat[2, :3]
            state.parameters["logit_opacities"].detach()[:] = 3.0

    return densify


def test_a_run_whose_gaussians_gather_at_the_cameras_goes_back_resumes_to_the_bit_and_says_so(
    world, views, quick, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = quick(iterations=300, checkpoint_every_s=0, start_scale=1.0, depth_from=1.0, held_out_every=4)
    sound = train(*world, settings, silent)
    monkeypatch.setattr("fastsplat.service.splatting.exposure.photometric_training._LOOKS", 0)
    monkeypatch.setattr(optimization, "densify_if_due", _gathering(views, 150))
    astray = train(*world, settings, silent)
    (said,) = astray.warnings
    assert "at step 216 it went back to step 108, with lower learning rates and each photo's exposure corrected" in said
    assert sound.warnings == () and astray.quality["psnr_cc"] > sound.quality["psnr_cc"] - 4

    save_trained(astray, tmp_path)
    assert load_trained(tmp_path).warnings == astray.warnings
    assert said in (scene_facts(astray, world[1], world[0], Settings(), SceneFacts()).warnings or ())
    with pytest.raises(CancelledError):
        train(*world, settings, stopping_at(160), tmp_path / "run")
    again = train(*world, settings, silent, tmp_path / "run")
    assert same_run(again, astray) and again.warnings == astray.warnings


@pytest.mark.parametrize("held_out_every", [0, 4])
def test_pictures_less_like_the_photos_than_one_color_are_no_scene(
    world, quick, tmp_path: Path, held_out_every: int
) -> None:
    settings = quick(iterations=250, held_out_every=held_out_every, photometric="off")
    colors = np.random.default_rng(1).choice([0, 255], (12, 3)).astype(np.uint8)
    with pytest.raises(TrainingDivergedError, match="PSNR") as error:
        train(repainted(world[0], tmp_path, lambda index, old: old * 0 + colors[index]), world[1], settings, silent)
    assert error.value.field == "quality.psnr" and error.value.limit
    for shade in (0, 128):
        uniform = repainted(world[0], tmp_path, lambda index, old, shade=shade: np.full_like(old, shade))
        train(uniform, world[1], settings, silent)
