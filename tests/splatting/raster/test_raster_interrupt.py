"""A long call into the kernels can be left, and holds up none of higher priority."""

from __future__ import annotations

import contextvars
import os
import signal
import threading
from contextlib import suppress

import pytest
import torch

from fastsplat.service.common.cancellation import Cancellation, cancellable
from fastsplat.service.common.process import lower_priority
from fastsplat.service.splatting.raster.image_formation import Rendering, Splats
from fastsplat.service.splatting.raster.kernels import running_with
from fastsplat.service.splatting.raster.rendering import rasterize
from fastsplat_contract.errors import CancelledError
from fastsplat_contract.geometry.camera import Camera

_LARGE = Camera(1600, 1600, 1600.0, 1600.0, 800.0, 800.0)
_SMALL = Camera(8, 8, 8.0, 8.0, 4.0, 4.0)


def _blankets() -> Splats:
    """A scene that takes long: every Gaussian covers every pixel."""
    count = 600
    means = torch.zeros(count, 3)
    means[:, 2] = torch.linspace(2.0, 3.0, count)
    return Splats(
        means,
        torch.tensor([1.0, 0.0, 0.0, 0.0]).repeat(count, 1),
        torch.full((count, 3), 1e3),
        torch.full((count,), 0.005),
        torch.ones(count, 16),
    )


class _Held(Cancellation):
    """A flag whose first check inside the kernels waits until it is let go, and then says that nobody waits."""

    def __init__(self) -> None:
        super().__init__()
        self.reached, self.let_go = threading.Event(), threading.Event()

    def check(self) -> None:
        self.reached.set()
        assert self.let_go.wait(60)
        self.cancel()
        super().check()


def test_a_call_between_its_tiles_is_cancelled_and_holds_up_none_of_higher_priority() -> None:
    blankets, held = _blankets(), _Held()
    outcome: list[object] = []

    def low() -> None:
        lower_priority(3)
        try:
            with cancellable(held), running_with(isa="baseline", threads=2):
                outcome.append(rasterize(blankets, torch.eye(4), _LARGE))
        except CancelledError as error:
            outcome.append(error)

    background = threading.Thread(target=low)
    background.start()
    try:
        assert held.reached.wait(60)  # in the middle of one view
        done: list[Rendering] = []
        with running_with(threads=2):
            camera = Camera(64, 64, 64.0, 64.0, 32.0, 32.0)
            high = threading.Thread(
                target=contextvars.copy_context().run,
                args=(lambda: done.append(rasterize(blankets, torch.eye(4), camera)),),
                daemon=True,
            )
            high.start()
        high.join(30)
        assert done and not outcome
    finally:
        held.let_go.set()
        background.join(60)
    assert len(outcome) == 1 and isinstance(outcome[0], CancelledError)


def test_the_kernels_threads_have_the_niceness_of_their_caller() -> None:
    def niceness() -> dict[int, int]:
        found: dict[int, int] = {}
        for task in map(int, os.listdir("/proc/self/task")):
            with suppress(ProcessLookupError):  # another test's thread may end meanwhile
                found[task] = os.getpriority(os.PRIO_PROCESS, task)
        return found

    def low() -> None:
        lower_priority(4)
        with running_with(threads=3):
            rasterize(_blankets(), torch.eye(4), Camera(64, 64, 64.0, 64.0, 32.0, 32.0))

    before = niceness()
    thread = threading.Thread(target=low)
    thread.start()
    thread.join(60)
    new = [value for task, value in niceness().items() if task not in before]
    assert new.count(min(19, os.getpriority(os.PRIO_PROCESS, 0) + 4)) >= 2  # others' threads may have begun, too


def test_a_signal_handler_that_raises_ends_the_call_and_the_next_one_works() -> None:
    blankets = _blankets()
    result: Rendering | None = None
    before = signal.signal(signal.SIGALRM, signal.default_int_handler)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.2)
        with pytest.raises(KeyboardInterrupt), running_with(isa="baseline"):
            result = rasterize(blankets, torch.eye(4), _LARGE)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
    assert result is None  # the call itself was left, not the line after it
    small = rasterize(blankets, torch.eye(4), _SMALL)
    assert float(small.alpha.min()) > 0.9
