"""Lines of a job's progress: few where much is counted, and none is missing where new work begins."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime

import pytest

from fastsplat.service.library.job_lines import ProgressLines, duration
from fastsplat_contract.jobs.operations import Operation, StageProgress


def test_times_are_said_in_few_letters() -> None:
    assert [duration(seconds) for seconds in (5, 700, 7_300)] == ["5 s", "12 min", "2 h 2 min"]


def test_a_long_stage_without_progress_says_what_it_does(capsys: pytest.CaptureFixture[str]) -> None:
    tell = ProgressLines()
    now = datetime.now(UTC)
    job = Operation("a", "b", "RUNNING", False, now, now, (), None, "create_scene", left_out={"7.gif": "unsupported"})

    def at(fraction: float, message: str, seconds: float = 1.0) -> None:
        tell(replace(job, stages=(StageProgress("perception", fraction, message, seconds, {}),)))

    for view in range(1, 201):
        at(0.0003 * view, f"looking for objects, view {view}/200")
    at(0.06, "segmenting 24 objects, view 1/16")
    at(0.06, "sorting 24 masks")
    for step in range(1, 1001):
        at(0.06 + 0.00001 * step, f"step {step}, {20 + step / 1000:.2f} dB")
    at(0.07, "step 1001, 21.00 dB", 31.0)
    tell(replace(job, state="SUCCEEDED", done=True))
    lines = capsys.readouterr().out.splitlines()
    assert [line.partition("% ")[2] or line for line in lines] == [
        "left out: 7.gif: unsupported",
        *(f"looking for objects, view {view}/200" for view in (1, 50, 100, 150, 200)),
        "segmenting 24 objects, view 1/16",
        "sorting 24 masks",
        "step 1, 20.00 dB",
        "step 1001, 21.00 dB",
        "SUCCEEDED",
    ]
