"""What every training run owes: progress, budgets, determinism, honest held-out views, typed failures."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from fastsplat.service.capture.captures import Capture
from fastsplat.service.common.dictionary import Dictionary
from fastsplat.service.common.progress import ProgressEvent, silent
from fastsplat.service.perception.results import Labelling
from fastsplat.service.planning.cost_model import SceneSize, fit_training, scene_size
from fastsplat.service.scene.gaussians.morton import morton_order
from fastsplat.service.splatting.gaussians import splats_of
from fastsplat.service.splatting.raster.rendering import rasterize, sh_to_rgb
from fastsplat.service.splatting.training.train import train
from fastsplat.service.splatting.training_settings import LearningRates, TrainingSettings
from fastsplat_contract.errors import CancelledError, InvalidInputError, TrainingDivergedError
from tests.splatting.training.conftest import masked, same_run


def test_a_run_learns_colour_and_meaning(world, quick) -> None:
    capture, labelling = world
    events: list[ProgressEvent] = []
    trained = train(capture, labelling, quick(iterations=300, max_gaussians=400), events.append)
    assert all(event.stage == "training" and 0 <= event.fraction <= 1 for event in events)
    assert events[-1].fraction == 1 and events[-1].metrics["iteration"] == 300
    start = train(capture, labelling, quick(iterations=5, max_gaussians=400), silent)
    assert trained.quality["loss"] < 0.3 * start.quality["loss"]
    assert trained.quality["psnr"] > 29 > start.quality["psnr"] + 8
    assert trained.quality["ssim"] > 0.95
    assert trained.held_out == ("004.png",)
    gaussians, head = trained.gaussians, trained.head
    posed, photo = capture.views[4].posed, np.asarray(Image.open(capture.views[4].image_path)) / 255
    means, sh, codes = (torch.from_numpy(rows) for rows in (gaussians.means, gaussians.sh, gaussians.codes))
    colors = sh_to_rgb(means, sh, torch.from_numpy(posed.world_from_camera[:3, 3]).float(), gaussians.sh_degree)
    viewmat = torch.from_numpy(posed.camera_from_world()).float()
    image = rasterize(splats_of(gaussians, torch.cat([colors, codes], 1)), viewmat, posed.camera).image.numpy()
    error = np.square(image[..., :3].clip(0, 1) - photo).mean()
    assert -10 * np.log10(error) == pytest.approx(trained.quality["psnr"], abs=1e-3)
    classes, truth = (image[..., 3:] @ head.weight.T + head.bias).argmax(axis=2), labelling.label_maps[4]
    ious = [np.sum((classes == n) & (truth == n)) / np.sum((classes == n) | (truth == n)) for n in (1, 2, 3)]
    assert np.mean(ious) > 0.85
    assert trained.gaussians.codes.shape[1] == 3
    assert trained.head.weight.shape == (4, 3)
    assert trained.quality["ghost_share"] == 0


def test_the_budget_is_never_exceeded(world, quick) -> None:
    capture, labelling = world
    counts: list[float] = []

    def listen(event: ProgressEvent) -> None:
        counts.append(event.metrics.get("gaussians", 0))

    settings = quick(iterations=60, max_gaussians=211, densify_events=60, full_count_at=0.3, cull_opacity=0)
    trained = train(capture, labelling, settings, listen)
    assert max(counts) == 211 == len(trained.gaussians)
    assert len(train(capture, labelling, quick(iterations=5, max_gaussians=40), silent).gaussians) <= 40
    assert len(train(capture, labelling, quick(iterations=3, max_gaussians=1), silent).gaussians) <= 1


def test_the_same_seed_gives_the_same_bits_and_another_seed_does_not(world, quick) -> None:
    settings, exact = quick(densify_events=10), dataclasses.replace(world[1], exact=True)  # which refits labels
    first, again, other_seed = (
        train(world[0], exact, s, silent) for s in (settings, settings, settings.model_copy(update={"seed": 1}))
    )
    assert same_run(first, again)
    assert not same_run(first, other_seed)
    order = morton_order(first.gaussians.means)
    assert (order == np.arange(len(order))).all(), "rows are in Morton order"


def test_held_out_views_never_touch_the_result(make_world, quick) -> None:
    capture, labelling = make_world(views=8)
    settings = quick(held_out_every=4, evaluations=5)
    before = train(capture, labelling, settings, silent)
    assert before.held_out == ("002.png", "006.png")
    random = np.random.default_rng(0)
    for name in before.held_out:
        path = capture.views[int(name[:3])].image_path
        Image.fromarray(random.integers(0, 255, (48, 64, 3), np.uint8)).save(path)
    maps = tuple(
        np.full_like(m, 3) if view.posed.name in before.held_out else m
        for view, m in zip(capture.views, labelling.label_maps, strict=True)
    )
    after = train(capture, Labelling(labelling.dictionary, maps), settings, silent)
    assert same_run(before, after)
    assert after.quality["psnr"] < before.quality["psnr"]


def _seeing_nothing(capture: Capture, index: int) -> Capture:
    """The capture with a black photo, taken of the empty side of the world."""
    Image.fromarray(np.zeros((48, 64, 3), np.uint8)).save(capture.views[index].image_path)
    view = capture.views[index]
    pose = view.posed.world_from_camera @ np.diag([-1.0, 1.0, -1.0, 1.0])
    views = list(capture.views)
    views[index] = dataclasses.replace(view, posed=dataclasses.replace(view.posed, world_from_camera=pose))
    return dataclasses.replace(capture, views=tuple(views))


@pytest.mark.parametrize("held_out_every", [8, 4])
@pytest.mark.parametrize("kind", ["masked", "black"])
def test_a_held_out_view_that_shows_nothing_does_not_spoil_the_figures(
    make_world, quick, held_out_every: int, kind: str
) -> None:
    capture, labelling = make_world(views=8)
    index = held_out_every // 2
    spoilt = (
        masked(capture, index, np.zeros((48, 64)))
        if kind == "masked"
        else _seeing_nothing(make_world(views=8)[0], index)
    )
    settings = quick(held_out_every=held_out_every, evaluations=5, tolerance_db=0.1)
    events: list[ProgressEvent] = []
    trained = train(spoilt, labelling, settings, events.append)
    assert trained.held_out[0] == f"{index:03d}.png" and trained.quality["held_out"] == 8 // held_out_every
    assert all(np.isfinite(value) for value in trained.quality.values())
    assert all(np.isfinite(value) for event in events for value in event.metrics.values())
    assert ("psnr" in trained.quality) == (held_out_every == 4)  # of the other view


def test_few_views_are_all_trained_on_and_one_that_shows_nothing_does_no_harm(make_world, quick) -> None:
    capture, labelling = make_world(views=3)
    trained = train(masked(capture, 1, np.zeros((48, 64))), labelling, quick(), silent)
    assert trained.held_out == () and "psnr" not in trained.quality
    assert all(np.isfinite(value) for value in trained.quality.values())


def test_pixels_without_content_never_touch_the_result(make_world, quick) -> None:
    capture, labelling = make_world(views=5)
    mask = np.full((48, 64), 255, np.uint8)
    mask[:, :10] = 0
    for index in range(5):
        capture = masked(capture, index, mask)
    settings = quick(iterations=6, start_scale=1, ssim_weight=0)
    before = train(capture, labelling, settings, silent)
    for view in capture.views:
        pixels = np.asarray(Image.open(view.image_path)).copy()
        pixels[:, :10] = 255
        Image.fromarray(pixels).save(view.image_path)
    for label_map in labelling.label_maps:
        label_map[:, :10] = 2
    after = train(capture, labelling, settings, silent)
    assert same_run(before, after)
    assert before.quality["psnr"] == after.quality["psnr"]


def test_a_scene_without_labels_trains_without_codes(world, quick) -> None:
    capture, labelling = world
    for empty in (Labelling(Dictionary(()), ()), Labelling(Dictionary(()), tuple(m * 0 for m in labelling.label_maps))):
        trained = train(capture, empty, quick(), silent)
        assert trained.gaussians.codes.shape == (len(trained.gaussians), 0)
        assert trained.head.weight.shape == (1, 0)
        assert trained.head.bias.shape == (1,)


@pytest.mark.parametrize("views", [1, 6])
def test_a_capture_without_points_starts_at_random_places_and_says_so(make_world, quick, views: int) -> None:
    capture, labelling = make_world(views=views)
    capture = dataclasses.replace(capture, points=capture.points[:0], point_colors=capture.point_colors[:0])
    heard: list[float] = []
    trained = train(capture, labelling, quick(), lambda e: heard.append(e.metrics.get("random_points", 0)))
    assert max(heard) == 250 == trained.quality["random_points"]
    assert train(*make_world(views=views), quick(), silent).quality["random_points"] == 0


def test_views_of_mixed_sizes_train_together(make_world, quick, tmp_path: Path) -> None:
    capture, labelling = make_world(views=4)
    (tmp_path / "small").mkdir()
    view = capture.views[1]
    path = tmp_path / "small" / "001.png"
    Image.open(view.image_path).resize((33, 25)).save(path)
    posed = dataclasses.replace(view.posed, camera=view.posed.camera.scaled_to(33, 25))
    views = (capture.views[0], dataclasses.replace(view, posed=posed, image_path=path), *capture.views[2:])
    maps = list(labelling.label_maps)
    maps[1] = np.zeros((25, 33), np.uint16)
    trained = train(
        dataclasses.replace(capture, views=views), Labelling(labelling.dictionary, tuple(maps)), quick(), silent
    )
    assert np.isfinite(trained.gaussians.means).all()


def test_cancelling_before_the_first_step_leaves_nothing(world, quick, tmp_path: Path) -> None:
    def stop(event: ProgressEvent) -> None:
        raise CancelledError("stop")

    with pytest.raises(CancelledError):
        train(*world, quick(), stop, tmp_path / "checkpoints")
    assert list(tmp_path.iterdir()) == []


def test_divergence_names_the_iteration_and_is_never_saved(world, quick, tmp_path: Path) -> None:
    settings = quick(rates=LearningRates(log_scales=1e30, sh_dc=1e38), checkpoint_every_s=1e9)
    with pytest.raises(TrainingDivergedError, match=r"iteration \d+"):
        train(*world, settings, silent, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_bad_captures_are_named(world, quick) -> None:
    capture, labelling = world
    points = capture.points.copy()
    points[3, 1] = np.nan
    with pytest.raises(InvalidInputError, match="1 points") as error:
        train(dataclasses.replace(capture, points=points), labelling, quick(), silent)
    assert error.value.field == "points"
    with pytest.raises(InvalidInputError, match="no registered views"):
        train(dataclasses.replace(capture, views=()), labelling, quick(), silent)
    with pytest.raises(InvalidInputError, match="11 label maps for 12"):
        train(capture, Labelling(labelling.dictionary, labelling.label_maps[1:]), quick(), silent)
    wrong = (labelling.label_maps[0][:-1], *labelling.label_maps[1:])
    with pytest.raises(InvalidInputError, match=r"label map of image 000\.png has 64×47"):
        train(capture, Labelling(labelling.dictionary, wrong), quick(), silent)


def test_a_time_bound_ends_a_run(world, quick) -> None:
    settings = quick(iterations=10**9, time_budget_s=0.5, min_iterations=100, max_gaussians=180)
    trained = train(*world, settings, silent)
    assert 0 < trained.quality["iterations"] < 10**9
    assert len(trained.gaussians) <= 180


def test_the_size_of_a_capture_is_that_of_its_largest_image(world) -> None:
    capture, labelling = world
    assert scene_size(capture, len(labelling.dictionary)) == SceneSize(12, 64, 48, len(capture.points), 0)
    given = dataclasses.replace(capture, given_labels=capture.views[0].image_path.parent)
    assert scene_size(given, len(labelling.dictionary)).labels == 3, "codes learn what came with the capture alone"
    assert scene_size(dataclasses.replace(capture, views=()), 0).width == 0


@pytest.mark.parametrize(("views", "gaussians"), [(1, 1), (1, 300), (12, 1)])
def test_the_smallest_plans_train_to_a_whole_scene(make_world, views: int, gaussians: int) -> None:
    capture, labelling = make_world(views)
    requested = TrainingSettings(max_gaussians=gaussians, tolerance_db=0.05)
    planned = fit_training(requested, scene_size(capture, 3), 1.0)
    trained = train(capture, labelling, planned.settings.model_copy(update={"iterations": 30}), silent)
    assert 1 <= len(trained.gaussians) <= gaussians and trained.quality["iterations"] <= 30
