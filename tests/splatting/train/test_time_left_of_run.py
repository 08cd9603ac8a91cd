"""What a run says of its time left."""

from __future__ import annotations

import pytest
import torch

from fastsplat.service.splatting import recorder as recorder_module
from fastsplat.service.splatting.recorder import Recorder
from fastsplat.service.splatting.state import Step, new_state


def test_the_time_left_follows_the_last_steps_and_not_the_first(quick, monkeypatch) -> None:
    monkeypatch.setattr(recorder_module, "_REPORT_EVERY_S", 0.0)
    events, elapsed_s = [], 0.0
    state = new_state({"means": torch.zeros(1, 3)})
    recorder = Recorder(quick(iterations=1_000, time_budget_s=None), events.append, (), 0, None)
    recorder.start(state, 0.0, 0.0)
    for number in range(200):
        elapsed_s += 0.1 if number < 100 else 1.0  # as when images and Gaussians have grown
        state.iteration = number + 1
        recorder.after_step(state, Step(number / 1_000, (number + 1) / 1_000, elapsed_s, 0.1))
    assert events[-1].metrics["iterations_per_second"] == pytest.approx(1.0)
    assert events[-1].metrics["seconds_left"] == pytest.approx(800.0)
