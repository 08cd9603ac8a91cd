"""Where a job stands, in lines for people."""

from __future__ import annotations

import re
import sys
from typing import TextIO

from fastsplat_contract.jobs.operations import Operation

_COUNT = re.compile(r"(\d+)/(\d+)")


def progress(operation: Operation) -> str:
    """Where a job stands, in one line."""
    if operation.error is not None:
        hint = operation.error.details.get("hint", "")
        return f"{operation.error.stage}: {operation.error.reason}: {operation.error.message}. {hint}".rstrip()
    if operation.done or not operation.stages:
        jobs = f", {operation.jobs_ahead} job{'s' * (operation.jobs_ahead > 1)} ahead" if operation.jobs_ahead else ""
        begins = f", begins in about {duration(operation.starts_in_s)}" if jobs and operation.starts_in_s else ""
        return f"{operation.state}{jobs}{begins}"
    last = operation.stages[-1]
    left = "" if operation.seconds_left is None else f", about {duration(operation.seconds_left)} left in all"
    return f"{last.stage} {last.fraction:.0%} {last.message}{left}"


def left_out(operation: Operation) -> list[str]:
    """The photos that a job does without, and why, a line each."""
    return [f"left out: {name}: {reason}" for name, reason in operation.left_out.items()]


def duration(seconds: float) -> str:
    """As "40 s", "12 min" or "3 h 5 min"."""
    if seconds < 100:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 100 else f"{minutes // 60} h {minutes % 60} min"


class ProgressLines:
    """Prints left-out photos, and each new state, work, part of a stage, and half minute.

    A part is a tenth of the stage, or a quarter of a count: messages change several times a second.

    Args:
        file: to print to; default stdout.
    """

    def __init__(self, file: TextIO | None = None) -> None:
        self._file = file
        self._last: tuple[object, ...] = ()

    def __call__(self, operation: Operation) -> None:
        if not self._last:
            for line in left_out(operation):
                self._print(line)
        step: tuple[object, ...] = (operation.state, operation.jobs_ahead)
        if operation.stages and not operation.done:
            stage = operation.stages[-1]
            quarters = [int(4 * int(done) / max(int(total), 1)) for done, total in _COUNT.findall(stage.message)]
            counts = (int(stage.fraction * 10), int(stage.seconds / 30), *quarters)
            step = (stage.stage, re.sub(r"[\d.]+", "", stage.message), *counts)
        if step != self._last:
            self._print(progress(operation))
        self._last = step

    def _print(self, line: str) -> None:
        print(line, file=self._file or sys.stdout, flush=True)
