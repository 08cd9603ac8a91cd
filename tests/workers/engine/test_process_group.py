"""What is known of a process by its id: stopped, running, over, or another one by now."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import pytest

from fastsplat.workers.engine.process_group import machine_id, process_state
from tests.workers.deployment import Deployment

_EVER = float("inf")


def test_a_process_is_running_then_stopped_then_over_though_nobody_has_reaped_it() -> None:
    process = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
    assert process_state(process.pid, _EVER) in ("R", "S", "D")
    os.kill(process.pid, signal.SIGSTOP)
    Deployment.wait_for(lambda: process_state(process.pid, _EVER) == "T")
    process.kill()
    Deployment.wait_for(lambda: process_state(process.pid, _EVER) == "")
    process.wait()
    assert process_state(process.pid, _EVER) == ""


def test_a_younger_process_of_the_same_id_is_another_one() -> None:
    assert process_state(os.getpid(), time.clock_gettime(time.CLOCK_BOOTTIME)) != ""
    assert process_state(os.getpid(), -10.0) == ""


def test_a_process_stays_the_same_one_when_the_clock_jumps(monkeypatch: pytest.MonkeyPatch) -> None:
    before, now = time.clock_gettime(time.CLOCK_BOOTTIME), time.time()
    monkeypatch.setattr(time, "time", lambda: now + 3600)
    assert process_state(os.getpid(), before) != ""


def test_the_machine_is_the_same_for_all_processes_in_it() -> None:
    command = [
        sys.executable,
        "-c",
        "from fastsplat.workers.engine.process_group import machine_id; print(machine_id())",
    ]
    assert subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip() == machine_id()
