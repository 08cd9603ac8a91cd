"""Views vote: a thing keeps one name in all of them, and comes back where a view missed it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from fastsplat.service.capture.types import Capture
from fastsplat.service.common.progress import ProgressEvent, silent
from fastsplat.service.perception.types import Labelling, Regions
from fastsplat.service.scene.types import Gaussians
from fastsplat.service.splatting.label_consensus import assign_labels, fuse_label_maps
from fastsplat.service.splatting.raster.types import LabelSums
from fastsplat.service.splatting.region_groups import group_regions
from fastsplat.service.splatting.settings import TrainingSettings
from fastsplat.service.splatting.train import train
from fastsplat.service.splatting.training_views import load_views, split_views
from fastsplat_contract.errors import CancelledError

World = tuple[Capture, Labelling]
FLOOR, BALL, BLOCK = 1, 2, 3


def region(label_map: np.ndarray, called: dict[int, tuple[tuple[int, float], ...]]) -> Regions:
    """Regions of the labels in `called`, in that order, with these votes."""
    ids = np.zeros(label_map.shape, np.uint16)
    for number, label in enumerate(called, start=1):
        ids[label_map == label] = number
    return Regions(ids, tuple(called.values()))


def flickering(labelling: Labelling) -> Labelling:
    """In every third view ball and block have each other's names, in every fourth one of them is not found."""
    regions, maps = [], []
    for index, label_map in enumerate(labelling.label_maps):
        ball, block = ((BALL, 0.6),), ((BLOCK, 0.6),)
        if index % 3 == 0:
            ball, block = ((BLOCK, 0.7), (BALL, 0.4)), ((BALL, 0.7),)
        called = {FLOOR: ((FLOOR, 0.9),), BALL: ball, BLOCK: block}
        if index % 4 == 1:
            del called[(BALL, BLOCK)[index // 4 % 2]]
        found = region(label_map, called)
        winners = np.array([0, *(max(votes, key=lambda vote: vote[1])[0] for votes in found.votes)], np.uint16)
        regions.append(found)
        maps.append(winners[found.ids])
    return Labelling(labelling.dictionary, tuple(maps), regions=tuple(regions))


def agreement(maps: list[np.ndarray], truth: list[np.ndarray]) -> float:
    """Share of the ball's and the block's pixels that carry their name."""
    things = [t > FLOOR for t in truth]
    right = sum(int(((m == t) & chosen).sum()) for m, t, chosen in zip(maps, truth, things, strict=True))
    return right / sum(int(chosen.sum()) for chosen in things)


@pytest.fixture(scope="module")
def geometry(world: World) -> Gaussians:
    """The world after a few hundred steps on colour alone."""
    settings = TrainingSettings(iterations=200, time_budget_s=None, max_gaussians=300, evaluations=0)
    return train(world[0], Labelling(world[1].dictionary, ()), settings, silent).gaussians


def test_flickering_names_settle_and_missing_things_come_back(world: World, geometry: Gaussians) -> None:
    capture, labelling = world
    noisy = flickering(labelling)
    truth = [label_map.astype(int) for label_map in labelling.label_maps]
    before = agreement([m.astype(int) for m in noisy.label_maps], truth)
    views = load_views(capture, noisy, tuple(range(12)), 640, (1.0,))
    maps, evidence = fuse_label_maps(geometry, views, noisy.regions, 4, expected=False, undetected_weight=0.3)
    assert before < 0.65
    assert agreement(maps, truth) > 0.9
    assert len(evidence) == len(geometry)


def test_no_regions_give_no_names(world: World, geometry: Gaussians) -> None:
    capture, labelling = world
    views = load_views(capture, labelling, (0, 1, 2), 640, (1.0,))
    nothing = [Regions(np.zeros((48, 64), np.uint16), ())] * 3
    maps, _ = fuse_label_maps(geometry, views, nothing, 4, expected=True, undetected_weight=0.3)
    assert not any(label_map.any() for label_map in maps)


def sums(*rows: dict[int, float]) -> LabelSums:
    """Per Gaussian, pixels by region."""
    starts = np.concatenate([[0], np.cumsum([len(row) for row in rows])])
    return LabelSums(
        torch.from_numpy(starts),
        torch.tensor([label for row in rows for label in sorted(row)], dtype=torch.int32),
        torch.tensor([row[label] for row in rows for label in sorted(row)], dtype=torch.float64),
    )


def test_regions_on_the_same_gaussians_are_one_thing_and_others_are_not() -> None:
    first = sums({1: 9.0, 0: 1.0}, {1: 9.0}, {2: 9.0}, {0: 9.0})
    second = sums({2: 5.0}, {2: 5.0, 0: 2.0}, {1: 5.0}, {0: 5.0})
    assert sorted(map(sorted, group_regions([first, second], [2, 2]))) == [[(0, 1), (1, 2)], [(0, 2), (1, 1)]]


def test_a_view_that_cannot_see_a_thing_neither_agrees_nor_disagrees() -> None:
    seen = sums({1: 9.0}, {1: 9.0}, {0: 9.0})
    hidden = sums({}, {}, {1: 9.0})
    again = sums({1: 4.0}, {1: 4.0}, {0: 4.0})
    assert sorted(map(sorted, group_regions([seen, hidden, again], [1, 1, 1]))) == [[(0, 1), (2, 1)], [(1, 1)]]
    assert group_regions([seen], [0]) == []


def blank(*votes: tuple[tuple[int, float], ...]) -> Regions:
    return Regions(np.zeros((1, 1), np.uint16), votes)


def test_the_name_with_most_votes_wins_unless_all_names_are_expected() -> None:
    # A detector that calls everything a mug (1), and one of the things sometimes a ramekin (2).
    regions = [blank(((1, 0.9),), ((1, 0.5), (2, 0.3)))] * 4
    things = [tuple((view, 1) for view in range(4)), tuple((view, 2) for view in range(4))]
    assert [instance.label for instance in assign_labels(things, regions, 3, expected=False)] == [1, 1]
    assert [instance.label for instance in assign_labels(things, regions, 3, expected=True)] == [1, 2]


def test_what_one_view_alone_believes_is_dropped() -> None:
    regions = [blank(((1, 0.9),))] * 20
    assert assign_labels([((0, 1),)], regions, 2, expected=False) == []
    assert len(assign_labels([tuple((view, 1) for view in range(3))], regions, 2, expected=False)) == 1
    assert len(assign_labels([((0, 1),)], regions[:1], 2, expected=False)) == 1  # there is no other view


def test_views_nobody_looked_at_do_not_vote_against(world: World, geometry: Gaussians) -> None:
    capture, labelling = world
    nothing = Regions(np.zeros((48, 64), np.uint16), ())
    called = {FLOOR: ((FLOOR, 0.9),), BALL: ((BALL, 0.9),), BLOCK: ((BLOCK, 0.9),)}
    regions = [region(labelling.label_maps[i], called) if i in (0, 3, 6) else nothing for i in range(12)]
    views = load_views(capture, labelling, tuple(range(12)), 640, (1.0,))
    maps, _ = fuse_label_maps(geometry, views, regions, 4, expected=False, undetected_weight=0.3)
    assert agreement(maps, [label_map.astype(int) for label_map in labelling.label_maps]) > 0.7


def test_a_rare_slip_never_names_a_thing() -> None:
    regions = [blank(((1, 0.9), (2, 0.01)))] * 4
    things = [tuple((view, 1) for view in range(4))]
    assert [instance.label for instance in assign_labels(things, regions, 3, expected=True)] == [1]


@pytest.mark.parametrize("mode", ["codes", "evidence"])
def test_a_run_on_detected_maps_learns_what_the_views_agree_on(
    world: World, quick: Callable[..., TrainingSettings], mode: str
) -> None:
    capture, labelling = world
    settings = quick(iterations=300, max_gaussians=300, label_mode=mode)
    trained = train(capture, flickering(labelling), settings, silent)
    if trained.evidence is None:
        classes = (trained.gaussians.codes @ trained.head.weight.T + trained.head.bias).argmax(axis=1)
    else:
        dense = np.zeros((len(trained.gaussians), 4))
        rows = np.repeat(np.arange(len(dense)), np.diff(trained.evidence.starts))
        dense[rows, trained.evidence.labels] = trained.evidence.counts
        classes = dense.argmax(axis=1)
    sh = trained.gaussians.sh[:, 0]
    solid = trained.gaussians.logit_opacities > 0
    red, blue = sh[:, 0] > sh[:, 2] + 0.8, sh[:, 2] > sh[:, 0] + 0.8
    assert (classes[red & solid] == BALL).mean() > 0.75 and (classes[blue & solid] == BLOCK).mean() > 0.75


def test_regions_of_held_out_views_have_no_say(world: World, quick: Callable[..., TrainingSettings]) -> None:
    capture, labelling = world
    noisy = flickering(labelling)
    _, held_out = split_views(12, 8)
    lying = tuple(
        Regions(found.ids * 0 + 1, (((FLOOR, 1.0),),)) if index in held_out else found
        for index, found in enumerate(noisy.regions)
    )
    settings = quick(iterations=30)
    before = train(capture, noisy, settings, silent)
    after = train(capture, dataclasses.replace(noisy, regions=lying), settings, silent)
    np.testing.assert_array_equal(before.gaussians.codes, after.gaussians.codes)


def test_a_run_interrupted_after_the_vote_ends_as_if_it_had_not_been(
    world: World, quick: Callable[..., TrainingSettings], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    capture, labelling = world
    noisy = flickering(labelling)
    settings = quick(iterations=40, checkpoint_every_s=0.0)
    whole = train(capture, noisy, settings, silent)

    def stop(event: ProgressEvent) -> None:
        if event.metrics.get("iteration", 0) >= 25:
            raise CancelledError("stop")

    monkeypatch.setattr("fastsplat.service.splatting.recorder._REPORT_EVERY_S", 0.0)
    with pytest.raises(CancelledError):
        train(capture, noisy, settings, stop, tmp_path)
    assert (tmp_path / "training.safetensors").exists()
    resumed = train(capture, noisy, settings, silent, tmp_path)
    for field in dataclasses.fields(Gaussians):
        np.testing.assert_array_equal(getattr(whole.gaussians, field.name), getattr(resumed.gaussians, field.name))
