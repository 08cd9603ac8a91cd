"""Laws of the labels' last fit."""

from __future__ import annotations

import numpy as np
import torch

from fastsplat.service.common.progress import silent
from fastsplat.service.scene.objects.label_evidence import posterior, seen_pixels
from fastsplat.service.splatting.gaussians import current_gaussians
from fastsplat.service.splatting.initial import start_gaussians, start_points
from fastsplat.service.splatting.labels.label_refit import consensus_codes, gaussian_label_loss, refit_codes
from fastsplat.service.splatting.labels.semantics import class_weights, separated_codes, start_head
from fastsplat.service.splatting.labels.view_evidence import views_evidence
from fastsplat.service.splatting.state import SplatState, new_state
from fastsplat.service.splatting.training.train import train
from fastsplat.service.splatting.training_views import TrainingView, load_views


def _started(world) -> tuple[SplatState, tuple[TrainingView, ...], torch.Tensor]:
    capture, labelling = world
    views = load_views(capture, labelling, tuple(range(len(capture.views))), 64, (1.0,))
    class_codes = separated_codes(4, 3, 0)
    start = start_points(capture.points, capture.point_colors, views, 250, 0)
    parameters = start_gaussians(start, 1.0, 0)
    weight, bias = start_head(class_codes)
    codes = torch.zeros(len(start.points), 3)
    return new_state(parameters | {"codes": codes, "weight": weight, "bias": bias}), views, class_codes


def _refit(state: SplatState, views, class_codes, epochs: int = 2) -> None:
    weights = class_weights(4, 1.0)
    refit_codes(state, views, class_codes, weights, undetected_weight=1.0, epochs=epochs, seed=0, backend="cpu")


def test_only_labels_change_and_they_are_those_of_the_maps(world) -> None:
    state, views, class_codes = _started(world)
    before = {name: value.detach().clone() for name, value in state.parameters.items()}
    _refit(state, views, class_codes)
    changed = {name for name, value in state.parameters.items() if not torch.equal(value, before[name])}
    assert changed == {"codes", "weight", "bias"}
    logits = state.parameters["codes"] @ state.parameters["weight"].T + state.parameters["bias"]
    heights = state.parameters["means"][:, 2].detach()
    floor = logits.argmax(dim=1)[heights.abs() < 0.06]
    assert (floor == 1).float().mean() > 0.7
    assert all(value.requires_grad and value.is_leaf for value in state.parameters.values())


def _evidence_classes(state: SplatState, views: tuple[TrainingView, ...]) -> torch.Tensor:
    evidence = views_evidence(current_gaussians(state.parameters), views, 4)
    return torch.from_numpy(posterior(evidence, 4).classes.astype(np.int64))


def _filled(state: SplatState, views: tuple[TrainingView, ...]) -> torch.Tensor:
    """Pixels of each Gaussian, in times those of the mean one."""
    pixels = seen_pixels(views_evidence(current_gaussians(state.parameters), views, 4))
    return torch.from_numpy(pixels / pixels.mean())


def _own_classes(state: SplatState) -> torch.Tensor:
    parameters = state.parameters
    return (parameters["codes"] @ parameters["weight"].T + parameters["bias"]).argmax(dim=1)


def test_without_epochs_all_but_large_gaussians_say_the_label_of_their_evidence_and_others_stay(world) -> None:
    state, views, class_codes = _started(world)
    state.parameters["codes"].data.normal_(generator=torch.Generator().manual_seed(0))
    state.parameters["log_scales"].data[::15] += 1.2
    before, classes = state.parameters["codes"].detach().clone(), _evidence_classes(state, views)
    agreed, large = _own_classes(state) == classes, _filled(state, views) >= 3.3
    assert 0.1 < agreed.float().mean() < 0.9 and (large & ~agreed).any() and large.float().mean() < 0.3
    _refit(state, views, class_codes, epochs=0)
    assert torch.equal(_own_classes(state)[~large], classes[~large])
    left = agreed | large
    assert torch.equal(state.parameters["codes"].detach()[left], before[left])
    assert torch.equal(state.parameters["weight"].detach(), start_head(class_codes)[0])


def test_looks_at_pixels_leave_gaussians_their_own_label(world) -> None:
    state, views, class_codes = _started(world)
    classes = _evidence_classes(state, views)
    _refit(state, views, class_codes, epochs=8)
    assert (_own_classes(state) == classes).float().mean() > 0.97


def test_a_label_that_no_code_says_starts_on_its_class_code() -> None:
    weight, codes = torch.eye(3), torch.tensor([[2.0, 0, 0], [4.0, 0, 0], [0, 3.0, 0], [0, 0, 1.0]])
    classes, opacities = torch.tensor([0, 0, 0, 1]), torch.tensor([0.75, 0.25, 0.5, 0.5])
    started = consensus_codes(codes, weight, torch.zeros(3), classes, opacities, class_codes=weight)
    assert torch.equal(started, torch.tensor([[2.0, 0, 0], [4.0, 0, 0], [2.5, 0, 0], [0, 1.0, 0]]))


def test_a_run_fits_labels_to_exact_maps_alone(world, quick) -> None:
    capture, labelling = world
    exact = type(labelling)(labelling.dictionary, labelling.label_maps, exact=True)
    fitted, left = (train(capture, exact, quick(label_refit_epochs=epochs), silent) for epochs in (2, 0))
    assert np.array_equal(fitted.gaussians.means, left.gaussians.means)
    assert np.array_equal(fitted.gaussians.sh, left.gaussians.sh)
    assert not np.array_equal(fitted.gaussians.codes, left.gaussians.codes)
    inexact = (train(capture, labelling, quick(label_refit_epochs=epochs), silent) for epochs in (2, 0))
    first, second = (trained.gaussians.codes for trained in inexact)
    assert np.array_equal(first, second)


def test_a_gaussian_counts_by_its_weight_in_the_loss_of_labels() -> None:
    parameters = {"codes": torch.eye(2), "weight": torch.eye(2), "bias": torch.zeros(2)}
    loss = gaussian_label_loss(parameters, torch.tensor([0, 0]), torch.tensor([3.0, 0.0]))
    assert torch.allclose(loss, 1.5 * torch.log1p(torch.exp(torch.tensor(-1.0))))
