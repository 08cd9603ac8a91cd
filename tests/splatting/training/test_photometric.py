"""Corrections of exposure and white balance: their effect on light, and when a run has them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from fastsplat.service.capture.captures import Capture
from fastsplat.service.common.progress import silent
from fastsplat.service.splatting.exposure.photometric import (
    channel_evs,
    correct,
    corrected_for,
    fitted_correction,
    from_light,
    to_light,
    zero_mean,
)
from fastsplat.service.splatting.exposure.photometric_training import (
    CORRECTIONS,
    FITS,
    PhotometricTraining,
    begin_corrections,
    start_corrections,
)
from fastsplat.service.splatting.results import TrainedSplats
from fastsplat.service.splatting.state import SplatState, new_state
from fastsplat.service.splatting.training import optimization
from fastsplat.service.splatting.training.depth_regularization import AnchorPoints, DepthAnchors, depth_anchors
from fastsplat.service.splatting.training.previews import TrainingWatch
from fastsplat.service.splatting.training.quality import color_corrected
from fastsplat.service.splatting.training.recorder import Recorder
from fastsplat.service.splatting.training.requirement import Requirement
from fastsplat.service.splatting.training.train import train
from fastsplat.service.splatting.training_settings import TrainingSettings
from fastsplat.service.splatting.training_views import Frame, TrainingView, load_views
from fastsplat_contract.errors import CancelledError
from tests.splatting.training.conftest import exposed, repainted, same_run, stopping_at

_CORRECTION = torch.tensor([0.7, -0.2, 0.1], dtype=torch.float64)


def _image(*shape: int) -> Tensor:
    """Values of the toe, below zero and above one among them."""
    return torch.rand(*shape, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1)) * 1.4 - 0.15


def test_a_correction_multiplies_light() -> None:
    """Against the curves of IEC 61966-2-1 themselves, for brighter and darker photos."""
    for correction in (_CORRECTION, -3 * _CORRECTION):
        expected = from_light(to_light(_image(12, 9)) * torch.exp2(channel_evs(correction)))
        assert torch.allclose(correct(_image(12, 9), correction), expected, rtol=0, atol=1e-7)
    assert torch.allclose(to_light(torch.tensor([0.0, 0.5, 1.0])), torch.tensor([0.0, 0.214041, 1.0]), atol=1e-6)
    # A gain of the stored values is another object: it misses by far more than a step of 8 bits.
    gray = torch.full((1, 1, 3), 0.2, dtype=torch.float64)
    exposure = torch.tensor([1.2, 0.0, 0.0], dtype=torch.float64)
    assert (correct(gray, exposure) - gray * correct(torch.ones_like(gray), exposure)).abs().max() > 4 / 255


def test_gradients_are_those_of_finite_differences() -> None:
    assert torch.autograd.gradcheck(correct, (_image(4, 5).requires_grad_(), _CORRECTION.clone().requires_grad_()))


def test_no_correction_changes_no_bit_and_two_undo_each_other() -> None:
    image = _image(6, 5)
    assert torch.equal(correct(image.float(), torch.zeros(3)), image.float())
    assert torch.allclose(correct(correct(image, _CORRECTION), -_CORRECTION), image, rtol=0, atol=1e-6)


def test_what_is_brighter_than_white_is_no_error() -> None:
    target = torch.tensor([[[1.0, 0.5, 1.0]]])
    image = torch.tensor([[[0.9, 0.5, 0.2]]])
    result = corrected_for(image, torch.tensor([1.0, 0.0, 0.0]), target)
    assert result[0, 0, 0] == 1 and result[0, 0, 1] > 0.6 and result[0, 0, 2] < 0.5


def test_a_fit_finds_the_correction_although_a_third_of_the_photo_shows_something_else() -> None:
    image = 0.2 + 0.3 * _image(40, 40).clamp(0, 1)
    target = correct(image, _CORRECTION)
    target[:13] = 0.9
    covered = torch.ones(40, 40)
    fit = fitted_correction(image, target, covered, None)
    assert fit is not None and torch.allclose(fit, _CORRECTION, atol=0.02)
    assert fitted_correction(image, target, torch.zeros(40, 40), None) is None
    assert fitted_correction(image, target, covered, torch.zeros(40, 40, dtype=torch.bool)) is None


def test_color_correction_undoes_an_affine_map_of_colors_and_no_more() -> None:
    image = _image(20, 20).clamp(0.2, 0.7).float()
    mixed = image @ torch.tensor([[0.9, 0.05, 0.0], [0.0, 0.8, 0.1], [0.05, 0.0, 1.0]]) + 0.03
    assert torch.allclose(color_corrected(image, mixed), mixed, atol=1e-4)
    noise = torch.rand(20, 20, 3, generator=torch.Generator().manual_seed(3)) * 0.9
    residual = (color_corrected(image, noise) - noise).square().mean()
    assert residual > 0.5 * (noise - noise.mean(dim=(0, 1))).square().mean()
    masked = torch.zeros(20, 20, dtype=torch.bool)
    assert torch.equal(color_corrected(image, mixed, masked), image), "without a pixel there is nothing to fit"


def _perturbed(capture: Capture, folder: Path) -> tuple[Capture, Tensor]:
    """The capture with photos of drawn exposures, and their corrections."""
    evs = np.random.default_rng(4).uniform(-0.8, 0.8, len(capture.views))
    corrections = torch.tensor(np.column_stack([evs, 0.05 * evs[::-1], -0.05 * evs]))
    new_capture = repainted(capture, folder, lambda index, pixels: exposed(pixels, corrections[index]))
    return new_capture, zero_mean(corrections)


def _rows(trained: TrainedSplats) -> Tensor:
    return torch.tensor(list(trained.photometric.values()), dtype=torch.float64)


def _same(first: TrainedSplats, second: TrainedSplats) -> bool:
    return same_run(first, second) and first.photometric == second.photometric


def test_a_run_finds_the_exposures_of_its_photos_by_itself(world, quick, tmp_path: Path) -> None:
    """And leaves no cast: the mean over the photos is zero."""
    capture, truth = _perturbed(world[0], tmp_path)
    settings = quick(iterations=360, held_out_every=0)
    trained = train(capture, world[1], settings, silent)
    rows = _rows(trained)
    assert rows.mean(dim=0).abs().max() < 1e-6
    assert (rows[:, 0] - truth[:, 0]).square().mean().sqrt() < 0.25 * truth[:, 0].square().mean().sqrt()
    assert list(trained.photometric) == [view.posed.name for view in capture.views]


def test_photos_that_agree_are_trained_as_if_nobody_had_looked(world, quick) -> None:
    looked = train(*world, quick(iterations=270, held_out_every=0), silent)
    off = train(*world, quick(iterations=270, held_out_every=0, photometric="off"), silent)
    assert _same(looked, off) and not looked.photometric


@pytest.mark.parametrize("stop_at", [8, 60], ids=["at the start", "after the decision"])
def test_a_run_with_corrections_resumes_to_the_bit(
    world, quick: Callable[..., TrainingSettings], tmp_path: Path, stop_at: int
) -> None:
    capture, _ = _perturbed(world[0], tmp_path)
    settings = quick(iterations=90, checkpoint_every_s=0, photometric="on", held_out_every=0)
    whole = train(capture, world[1], settings, silent)
    assert whole.photometric

    with pytest.raises(CancelledError):
        train(capture, world[1], settings, stopping_at(stop_at), tmp_path / "run")
    assert _same(train(capture, world[1], settings, silent, tmp_path / "run"), whole)


def test_photos_that_differ_are_corrected_after_as_many_steps_however_long_the_run_is_to_be(
    world, quick, tmp_path: Path
) -> None:
    capture, truth = _perturbed(world[0], tmp_path)
    settings = quick(iterations=40_000, held_out_every=0)
    rows = _rows(train(capture, world[1], settings, silent, watch=TrainingWatch(finish=lambda: True)))
    assert (rows - truth)[:, 0].square().mean().sqrt() < 0.4 * truth[:, 0].square().mean().sqrt()


def _noted(spread: float, iteration: int, name: str = FITS) -> SplatState:
    """A state whose four photos were found to differ by so many EV."""
    rows = torch.tensor([[3 + sign * spread, 0.0, 0.0, 2.0] for sign in (-1.0, 1.0, -1.0, 1.0)])
    state = new_state({"means": torch.zeros(1, 3), name: rows if name == FITS else zero_mean(rows[:, :3])})
    state.iteration = iteration
    return state


@pytest.mark.parametrize(
    ("spread", "iteration", "before", "after"),
    [
        (0.5, 99, FITS, FITS),  # not before each photo has been seen
        (0.5, 100, FITS, CORRECTIONS),
        (0.02, 100, FITS, FITS),
        (0.16, 100, FITS, FITS),  # in doubt: the first pictures are crude
        (0.16, 150, FITS, CORRECTIONS),
        (0.13, 150, CORRECTIONS, CORRECTIONS),
        (0.11, 150, CORRECTIONS, FITS),
        (0.13, 150, FITS, FITS),  # what was dropped begins again where photos differ by more
        (0.02, 300, FITS, None),  # the last look
        (0.02, 300, CORRECTIONS, None),
    ],
)
def test_corrections_begin_where_photos_differ_and_are_dropped_where_they_agree(
    spread: float, iteration: int, before: str, after: str | None
) -> None:
    state = _noted(spread, iteration, before)
    PhotometricTraining(TrainingSettings()).decide_if_due(state)
    assert [name for name in (FITS, CORRECTIONS) if name in state.parameters] == ([after] if after else [])
    assert state.exp_avg.keys() == state.parameters.keys()
    if (before, after) == (FITS, CORRECTIONS):
        assert torch.allclose(state.parameters[CORRECTIONS][:, 0], spread * torch.tensor([-1.0, 1.0, -1.0, 1.0]))
    forced_state = _noted(0.02, 150, CORRECTIONS)
    PhotometricTraining(TrainingSettings(photometric="on")).decide_if_due(forced_state)
    assert CORRECTIONS in forced_state.parameters


def test_corrections_that_begin_late_move_as_torchs_adam_moves_them_from_its_first_step() -> None:
    settings = TrainingSettings(iterations=1000, time_budget_s=None)
    training = PhotometricTraining(settings)
    state = new_state({"means": torch.zeros(1, 3), FITS: torch.zeros(3, 4)})
    for visit in range(120):
        training.step(state, visit % 3, 0.1, torch.zeros(3))
    state.parameters[FITS].detach()[:] = torch.tensor([[0.5, 0, 0, 1], [-0.5, 0, 0, 1], [0, 0.5, 0, 1]])
    begin_corrections(state, 3)
    corrections, random = state.parameters[CORRECTIONS], torch.Generator().manual_seed(5)
    expected = [torch.nn.Parameter(row.clone()) for row in corrections.detach()]
    rate = settings.rates.photometric_at(0.3)
    adams = [torch.optim.Adam([row], lr=rate, eps=1e-15) for row in expected]
    for number in (0, 0, 1, 2, 1, 0, 2, 2, 1, 0):
        gradient = torch.randn(3, generator=random)
        corrections.grad, expected[number].grad = torch.zeros(3, 3), gradient
        corrections.grad[number] = gradient
        training.step(state, number, 0.3, None)
        adams[number].step()
        for row, centered in zip(expected, zero_mean(torch.stack([row.detach() for row in expected])), strict=True):
            row.data.copy_(centered)
        assert torch.allclose(corrections.detach(), torch.stack([row.detach() for row in expected]), rtol=0, atol=1e-6)


def test_exif_is_where_corrections_start(world, quick) -> None:
    evs = (4.0, 6.0, None, 5.0)
    some = [dataclasses.replace(view, exposure_ev=ev) for view, ev in zip(world[0].views, evs, strict=False)]
    capture = dataclasses.replace(world[0], views=tuple(some))
    views = load_views(capture, world[1], (0, 1, 2, 3), 64, (1.0,))
    start = start_corrections(views, quick())
    assert torch.allclose(start[CORRECTIONS][:, 0], torch.tensor([-1.0, 1.0, 0.0, 0.0]))
    equal = [dataclasses.replace(view, exposure_ev=5.0) for view in views]
    assert FITS in start_corrections(equal, quick()), "a locked exposure says nothing of the white balance"
    assert start_corrections(views, quick(photometric="off")) == {}


def test_points_are_looked_for_in_the_colors_that_the_photo_gives_them(world, quick, monkeypatch) -> None:
    brightness: dict[float | None, list[float]] = {-1.0: [], 1.0: []}

    def noted(points: AnchorPoints, view: TrainingView, frame: Frame) -> DepthAnchors:
        brightness[view.exposure_ev].append(float(points.colors.mean()))
        return depth_anchors(points, view, frame)

    monkeypatch.setattr(optimization, "depth_anchors", noted)
    settings = quick(iterations=12, depth_from=0.0, depth_every=1, held_out_every=0)
    views = (dataclasses.replace(view, exposure_ev=i % 2 * 2 - 1.0) for i, view in enumerate(world[0].views))
    train(dataclasses.replace(world[0], views=tuple(views)), world[1], settings, silent)
    assert len(brightness[-1.0]) == len(brightness[1.0]) == 6
    assert max(brightness[-1.0]) < 0.8 * min(brightness[1.0])


def test_a_picture_is_judged_by_what_its_photo_would_show_of_it(world, quick) -> None:
    frame = load_views(*world, (0,), 64, (1.0,))[0].frames[-1]
    correction, events = torch.tensor([0.8, 0.0, 0.0]), []
    image = 0.3 + 0.3 * frame.target()
    recorder = Recorder(quick(), events.append, (), 0, None)
    recorder.observe_image(0, image, correct(image, correction), frame, correction)
    recorder.report(new_state({"means": torch.zeros(1, 3)}), 0.0, 0.0)
    assert "psnr" not in events[0].metrics  # equal pictures have no finite one
    recorder.observe_image(0, image, image, frame, correction)
    recorder.report(new_state({"means": torch.zeros(1, 3)}), 0.0, 0.0)
    assert events[1].metrics["psnr"] < 20


def test_a_corrected_run_is_judged_by_the_figure_that_does_not_know_the_exposure(world, quick, monkeypatch) -> None:
    judged = []
    monkeypatch.setattr(Requirement, "finish", lambda self: judged.append(self._psnr(self._state.parameters)))
    for photometric, figure, other_figure in (("on", "psnr_cc", "psnr"), ("off", "psnr", "psnr_cc")):
        settings = quick(photometric=photometric, held_out_every=4, iterations=260)
        quality = train(*world, settings, silent).quality
        assert (
            judged.pop() == pytest.approx(quality[figure], abs=1e-3) != pytest.approx(quality[other_figure], abs=1e-3)
        )


def test_corrections_go_on_from_the_training_stage_into_the_scenes_figures(world, quick, tmp_path: Path) -> None:
    from fastsplat.service.jobs.create_scene import scene_quality
    from fastsplat.workers.kinds.create_scene import load_trained, save_trained

    trained = train(*world, quick(photometric="on"), silent)
    save_trained(trained, tmp_path)
    loaded = load_trained(tmp_path)
    assert _same(loaded, trained) and loaded.photometric
    quality = scene_quality(loaded, world[0], {})
    assert quality["photometric"].keys() == trained.photometric.keys()
    assert quality["psnr_cc"] == trained.quality["psnr_cc"]
    off = scene_quality(train(*world, quick(photometric="off"), silent), world[0], {})
    assert "photometric" not in off
