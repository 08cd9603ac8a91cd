"""Laws of the trainer's pure parts."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from fastsplat.service.scene.artefact.scene import SH_C0, SemanticHead
from fastsplat.service.scene.gaussians.morton import morton_order
from fastsplat.service.splatting.gaussians import rotate
from fastsplat.service.splatting.initial import StartPoints, start_gaussians, start_points
from fastsplat.service.splatting.labels.semantics import (
    code_size,
    ghost_share,
    separated_codes,
    start_codes,
    start_head,
)
from fastsplat.service.splatting.state import new_state
from fastsplat.service.splatting.training.densify import (
    MAX_COPIES,
    planned_count,
    relocate_and_grow,
    split_in_place,
)
from fastsplat.service.splatting.training.quality import psnr, ssim
from fastsplat.service.splatting.training.schedule import (
    event_due,
    image_level,
    image_scales,
    learning_rates,
    run_progress,
    sh_degree,
)
from fastsplat.service.splatting.training_settings import TrainingSettings
from fastsplat.service.splatting.training_views import load_views, split_views, training_size
from fastsplat_contract.geometry.camera import Camera
from tests.splatting.training.conftest import drawn_parameters


@given(st.integers(0, 200), st.integers(0, 50))
def test_a_split_is_a_partition_and_few_views_keep_none_back(count: int, every: int) -> None:
    training_views, held_out = split_views(count, every)
    assert sorted(training_views + held_out) == list(range(count))
    assert bool(held_out) == (count >= 4 and every >= 2)
    assert len(held_out) <= max(1, math.ceil(count / max(every, 1)))
    assert count == 0 or training_views


def test_morton_order_follows_the_curve_and_keeps_equal_rows() -> None:
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float32)
    shuffled = np.random.default_rng(0).permutation(8)
    assert (corners[shuffled][morton_order(corners[shuffled])] == corners).all()
    assert (morton_order(np.ones((5, 3), np.float32)) == np.arange(5)).all()
    assert len(morton_order(np.zeros((0, 3), np.float32))) == 0


@given(st.floats(0.01, 0.98), st.integers(1, MAX_COPIES))
def test_parts_composite_to_the_whole(opacity: float, copies: int) -> None:
    whole, scale = torch.tensor([opacity], dtype=torch.float64), torch.ones(1, 3, dtype=torch.float64)
    part, narrow = split_in_place(whole, scale, torch.tensor([copies]))
    x = torch.linspace(-8, 8, 20001, dtype=torch.float64)
    before = opacity * torch.exp(-0.5 * x**2)
    after = 1 - (1 - part * torch.exp(-0.5 * (x / narrow[0, 0]) ** 2)) ** copies
    assert 1 - (1 - part.item()) ** copies == pytest.approx(opacity, rel=1e-6)
    assert after.sum().item() == pytest.approx(before.sum().item(), rel=1e-3)


def test_growth_is_monotonic_and_bounded() -> None:
    counts = [planned_count(share, 100, 977, 0.1, 0.6) for share in np.linspace(0, 1, 101)]
    assert counts[0] == 100 and counts[-1] == 977 and max(counts) == 977
    assert counts == sorted(counts)
    assert planned_count(0.0, 50, 50, 0.1, 0.6) == 50


def _state(count: int, dead: int):
    logits = torch.full((count,), 1.0)
    logits[:dead] = -9.0
    head = {"weight": torch.ones(3, 2), "bias": torch.ones(3)}
    return new_state(drawn_parameters(count) | {"logit_opacities": logits} | head)


def test_relocation_moves_the_dead_onto_the_needed_and_grows_to_the_target() -> None:
    state = _state(50, 7)
    for moments in (state.exp_avg, state.exp_avg_sq):
        for value in moments.values():
            value.fill_(1.0)
    need = torch.zeros(50)
    need[[20, 21]] = 1
    need[3] = 100  # dead: may not be a source
    codes = state.parameters["codes"].detach().clone()
    placed = relocate_and_grow(state, need, 60, 0.005, torch.Generator().manual_seed(1))
    assert placed == 17 and state.count == 60
    moved = list(range(7)) + list(range(50, 60))
    assert {tuple(row) for row in state.parameters["codes"][moved].tolist()} <= {
        tuple(row) for row in codes[20:22].tolist()
    }
    assert (torch.sigmoid(state.parameters["logit_opacities"]) > 0.005).all()
    for name in ("means", "codes"):
        assert len(state.exp_avg[name]) == len(state.exp_avg_sq[name]) == 60
        assert (state.exp_avg[name][[*moved, 20, 21]] == 0).all()
        assert (state.exp_avg_sq[name][[19, 22, 49]] == 1).all()
    assert len(torch.unique(state.parameters["means"][moved], dim=0)) == 17
    assert all(value.requires_grad and value.is_leaf for value in state.parameters.values())


def test_nothing_to_move_changes_nothing() -> None:
    state = _state(10, 0)
    before = state.parameters["means"].detach().clone()
    assert relocate_and_grow(state, torch.ones(10), 10, 0.005, torch.Generator()) == 0
    assert relocate_and_grow(_state(5, 5), torch.ones(5), 9, 0.005, torch.Generator()) == 0
    assert (state.parameters["means"] == before).all()


def test_rotation_by_a_quarter_turn_about_z() -> None:
    quats = torch.tensor([[2.0, 0, 0, 2.0]])
    assert rotate(quats, torch.tensor([[1.0, 0, 0]])) == pytest.approx(torch.tensor([[0.0, 1.0, 0.0]]), abs=1e-6)


def test_schedules_follow_whichever_bound_is_nearer() -> None:
    settings = TrainingSettings(iterations=100, time_budget_s=10, min_iterations=0, max_sh_degree=2, start_scale=0.25)
    assert run_progress(50, 2, settings) == 0.5
    assert run_progress(10, 9, settings) == 0.9
    assert run_progress(500, 2, settings) == 1
    assert run_progress(10, 1e9, settings.model_copy(update={"time_budget_s": None})) == 0.1
    assert image_scales(settings) == (0.25, 0.5, 1.0)
    levels = [image_level(share, settings) for share in np.linspace(0, 1, 101)]
    degrees = [sh_degree(share, settings) for share in np.linspace(0, 1, 101)]
    assert levels == sorted(levels) and set(levels) == {0, 1, 2} and levels[-1] == 2
    assert degrees == sorted(degrees) and degrees[0] == 0 and degrees[-1] == 2
    assert sum(event_due((i - 1) / 137, i / 137, 20) for i in range(1, 138)) == 20


@given(st.integers(0, 2_000), st.floats(0, 1e6), st.floats(0, 1e3))
def test_the_clock_ends_no_run_before_its_fewest_steps(iteration: int, elapsed_s: float, later_s: float) -> None:
    settings = TrainingSettings(iterations=1_000, time_budget_s=10, min_iterations=250)
    progress = run_progress(iteration, elapsed_s, settings)
    assert (progress == 1) == (iteration >= 1_000 or (iteration >= 250 and elapsed_s >= 10))
    assert run_progress(iteration + 1, elapsed_s + later_s, settings) >= progress


def test_learning_rates_end_where_the_settings_say() -> None:
    settings = TrainingSettings()
    start, end = learning_rates(0, 2.0, settings), learning_rates(1, 2.0, settings)
    assert start["means"] == pytest.approx(2 * settings.rates.means)
    assert end["means"] == pytest.approx(2 * settings.rates.means_final)
    assert end["sh_dc"] == pytest.approx(settings.rates.final_share * settings.rates.sh_dc)


@pytest.mark.parametrize("labels", [1, 2, 3, 5, 11, 17])
def test_automatic_codes_start_without_ghosts(labels: int) -> None:
    size = code_size(labels, "auto")
    codes = separated_codes(labels + 1, size, 0)
    weight, bias = start_head(codes)
    assert codes.norm(dim=1) == pytest.approx(torch.ones(labels + 1))
    assert ((codes @ weight.T + bias).argmax(1) == torch.arange(labels + 1)).all()
    head = SemanticHead(weight.numpy(), bias.numpy())
    assert ghost_share(codes.numpy(), np.zeros(labels + 1, np.float32), head) == 0


def test_code_sizes() -> None:
    assert code_size(0, "auto") == 0 == code_size(0, 8)
    assert code_size(17, "auto") == 8 and code_size(17, 3) == 3
    sizes = [code_size(labels, "auto") for labels in range(1, 300)]
    assert sizes == sorted(sizes) and sizes[-1] == 13


def test_a_third_label_between_two_is_a_ghost() -> None:
    weight = np.array([[0, 0], [-2, 0], [0, 0], [2, 0]], np.float32)
    codes = np.array([[-2, 0], [0, 0], [2, 0]], np.float32)
    head = SemanticHead(weight, np.array([-9, 0, 1, 0], np.float32))
    assert ghost_share(codes, np.zeros(3, np.float32), head) == pytest.approx(1 / 3)


def test_points_start_on_their_label(world) -> None:
    capture, labelling = world
    views = load_views(capture, labelling, tuple(range(12)), 64, (1.0,))
    class_codes = torch.eye(4)
    inside_ball, inside_block = np.array([[-0.4, 0.1, 0.4]], np.float32), np.array([[0.4, -0.1, 0.35]], np.float32)
    nowhere = np.array([[0, 0, 50]], np.float32)
    codes = start_codes(np.concatenate([inside_ball, inside_block, nowhere]), views, class_codes)
    assert codes.argmax(dim=1).tolist() == [2, 3, 0]


def test_random_points_lie_where_several_cameras_look(world) -> None:
    capture, labelling = world
    views = load_views(capture, labelling, tuple(range(12)), 64, (1.0,))
    start = start_points(capture.points[:0], capture.point_colors[:0], views, 700, 3)
    assert start.random == 700 == len(start.points)
    seen = np.zeros(700)
    for view in capture.views:
        seen[view.posed.in_picture(start.points)[0]] += 1
    assert seen.min() >= 2
    assert (start.points == start_points(capture.points[:0], capture.point_colors[:0], views, 700, 3).points).all()


def test_white_points_start_white_and_no_more_than_allowed(world) -> None:
    views, points = load_views(*world, (0, 1), 64, (1.0,)), np.random.default_rng(0).normal(size=(216, 3))
    start = start_points(points.astype(np.float32), np.full((216, 3), 255, np.uint8), views, 101, 0)
    parameters = start_gaussians(start, 10, 1)
    assert 0.5 + SH_C0 * parameters["sh_dc"].numpy() == pytest.approx(1) and parameters["sh_rest"].shape == (101, 3, 3)


def test_pictures_are_reduced_never_enlarged() -> None:
    camera = Camera(400, 300, 400, 400, 200, 150)
    small = training_size(camera, 100)
    assert (small.width, small.height, small.fx, small.cy) == (100, 75, 100, 37.5)
    assert training_size(camera, 1000) == camera
    assert training_size(camera, 1000, 0.5).width == 200


def test_quality_measures_know_equal_and_masked_pictures() -> None:
    random = torch.Generator().manual_seed(0)
    target = torch.rand(20, 30, 3, generator=random)
    image = target.clone()
    image[:, :12] = 0.5
    valid = torch.ones(20, 30, dtype=torch.bool)
    valid[:, :20] = False
    assert psnr(target, target) == math.inf and ssim(target, target) == pytest.approx(1)
    assert psnr(target.clamp(0, 0.8) + 0.1, target.clamp(0, 0.8)) == pytest.approx(20, abs=1e-4)
    assert psnr(image, target, valid) == math.inf and ssim(image, target, valid) == pytest.approx(1)
    assert ssim(image, target) < 0.99


@pytest.mark.parametrize("count", [2, 3, 4, 700])
def test_start_widths_agree_with_every_distance_measured(count: int) -> None:
    points = np.random.default_rng(count).normal(size=(count, 3)).astype(np.float32)
    points[-1] = points[0]  # two at one place
    away = np.sort(np.linalg.norm(points[:, None].astype(np.float64) - points, axis=2), axis=1)[:, 1:4]
    expected = np.clip(np.sqrt((away**2).mean(axis=1)), 1e-3, None)
    parameters = start_gaussians(StartPoints(points, np.zeros_like(points), 0), 100, 0)
    assert np.exp(parameters["log_scales"][:, 0].numpy()) == pytest.approx(expected, rel=1e-4)
