"""Laws of the labels' last fit."""

from __future__ import annotations

import numpy as np
import torch

from fastsplat.service.common.progress import silent
from fastsplat.service.splatting.initial import start_gaussians, start_points
from fastsplat.service.splatting.label_refit import refit_codes
from fastsplat.service.splatting.semantics import class_weights, separated_codes, start_head
from fastsplat.service.splatting.state import SplatState, new_state
from fastsplat.service.splatting.train import train
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


def test_without_epochs_every_gaussian_has_the_code_of_its_label(world) -> None:
    state, views, class_codes = _started(world)
    _refit(state, views, class_codes, epochs=0)
    same = state.parameters["codes"].detach()[:, None] == class_codes
    assert same.all(dim=2).any(dim=1).all()
    assert torch.equal(state.parameters["weight"].detach(), start_head(class_codes)[0])


def test_the_same_seed_gives_the_same_bits(world) -> None:
    (one, views, class_codes), (other, _, _) = _started(world), _started(world)
    for state in (one, other):
        _refit(state, views, class_codes)
    assert torch.equal(one.parameters["codes"], other.parameters["codes"])


def test_a_run_fits_labels_to_exact_maps_alone(world, quick) -> None:
    capture, labelling = world
    exact = type(labelling)(labelling.dictionary, labelling.label_maps, exact=True)
    fitted, left = (train(capture, exact, quick(label_refit_epochs=epochs), silent) for epochs in (2, 0))
    assert np.array_equal(fitted.gaussians.means, left.gaussians.means)
    assert np.array_equal(fitted.gaussians.sh, left.gaussians.sh)
    assert not np.array_equal(fitted.gaussians.codes, left.gaussians.codes)
    inexact = (train(capture, labelling, quick(label_refit_epochs=epochs), silent) for epochs in (2, 0))
    one, other = (trained.gaussians.codes for trained in inexact)
    assert np.array_equal(one, other)
