"""A training is watched, and ended early: pictures within their budget, and a scene of what was there."""

from __future__ import annotations

import gc
import weakref

import cv2
import numpy as np
import pytest

from fastsplat.service.common.progress import ProgressEvent, silent
from fastsplat.service.splatting.results import TrainedSplats
from fastsplat.service.splatting.training import optimization
from fastsplat.service.splatting.training.previews import PREVIEW_SHARE, PreviewBudget, TrainingPreview, TrainingWatch
from fastsplat.service.splatting.training.train import train
from fastsplat_contract.errors import CancelledError
from tests.splatting.training.conftest import same_run


@pytest.mark.parametrize("cost_s", [0.001, 0.02, 1.5])
def test_pictures_take_no_more_than_their_share_of_any_time(cost_s: float) -> None:
    budget, made_at, now = PreviewBudget(), [], 0.0
    while now < 3_600:
        if budget.is_due(now):
            now += cost_s
            budget.spend(now, cost_s)
            made_at.append(now)
            # The first is made before there is any time to share; the others are paid for in advance.
            assert len(made_at) == 1 or budget.spent_s <= PREVIEW_SHARE * now
        now += 0.1
    assert made_at[0] == cost_s and budget.spent_s <= PREVIEW_SHARE * now
    gaps = np.diff(made_at)
    # The second also waits until the first is paid for; then never denser than before, but for the clock's steps.
    assert len(gaps) > 5 and (np.diff(gaps[1:]) > -0.2 - 1e-9).all()
    assert gaps.max() < max(32.0, 2.2 * cost_s / PREVIEW_SHARE)


def test_a_run_shows_itself_hands_on_what_it_has_at_the_shares_that_are_asked_for_and_stays_the_same(
    world, quick
) -> None:
    pictures: list[TrainingPreview] = []
    drafts: list[tuple[TrainedSplats, float]] = []
    watch = TrainingWatch(pictures.append, draft=lambda *draft: drafts.append(draft), drafts_at=(0.25, 0.5))
    watched, alone = (
        train(*world, quick(iterations=12), silent, watch=watch),
        train(*world, quick(iterations=12), silent),
    )
    assert same_run(watched, alone)

    first = pictures[0]
    assert first.step == 1 and first.gaussians > 0
    assert first.view in {view.posed.name for view in world[0].views} - set(watched.held_out)
    pixels = cv2.imdecode(np.frombuffer(first.jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert pixels.shape == (first.height, first.width, 3) and max(pixels.shape) <= 320 and pixels.std() > 1
    assert 0 < watched.quality["preview_seconds"] < watched.quality["train_seconds"]

    assert [share for _, share in drafts] == [0.25, 0.5]
    for splats, _ in drafts:
        assert len(splats.gaussians) and np.isfinite(splats.gaussians.means).all()
        assert splats.head.weight.shape == alone.head.weight.shape


@pytest.fixture
def fewest_steps(monkeypatch: pytest.MonkeyPatch) -> int:
    """Steps that a run takes before it may end early; few here."""
    monkeypatch.setattr(optimization, "FEWEST_STEPS", 40)
    return 40


def test_a_run_that_is_ended_early_has_the_least_steps_and_says_so(world, quick, fewest_steps: int) -> None:
    iterations: list[float] = []

    def note(event: ProgressEvent) -> None:
        iterations.append(event.metrics.get("iteration", 0))

    trained = train(*world, quick(iterations=64), note, watch=TrainingWatch(finish=lambda: True))
    assert trained.quality["iterations"] == fewest_steps
    assert trained.quality["stopped_at_share"] == pytest.approx(fewest_steps / 64)
    assert len(trained.gaussians) > 0 and "psnr" in trained.quality
    whole = train(*world, quick(iterations=20), silent, watch=TrainingWatch(finish=lambda: True))
    assert whole.quality["iterations"] == 20 and "stopped_at_share" not in whole.quality


def test_a_run_that_was_ended_early_is_not_trained_further_after_a_crash(
    world, quick, tmp_path, fewest_steps: int
) -> None:
    settings = quick(iterations=64, checkpoint_every_s=1_000)
    watch = TrainingWatch(finish=lambda: True)

    def crash_at_the_end(event: ProgressEvent) -> None:
        if event.fraction == 1.0:
            raise CancelledError("crash")

    with pytest.raises(CancelledError):
        train(*world, settings, crash_at_the_end, tmp_path, watch=watch)
    again = train(*world, settings, silent, tmp_path, watch=watch)
    assert again.quality["iterations"] == fewest_steps and again.quality["stopped_at_share"] < 1


def test_when_a_run_is_over_nothing_holds_its_views(world, quick, monkeypatch: pytest.MonkeyPatch) -> None:
    references: list[weakref.ref[optimization.Trainer]] = []

    class Watched(optimization.Trainer):
        def run(self) -> None:
            references.append(weakref.ref(self))
            super().run()

    monkeypatch.setattr("fastsplat.service.splatting.training.train.Trainer", Watched)
    gc.disable()  # on a GPU, whose memory Python does not count, it may come late
    try:
        train(*world, quick(iterations=2), silent, watch=TrainingWatch(lambda picture: None))
        assert len(references) == 1 and references[0]() is None
    finally:
        gc.enable()
