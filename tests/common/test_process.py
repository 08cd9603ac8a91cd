"""A child dies with its parent; a process that yields is nicer, and so is its session."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import pytest

from tests.processes import is_alive

_CHILD = """
import sys, time
from fastsplat.service.common.process import die_with_parent
die_with_parent(int(sys.argv[1]))
print("alive", flush=True)
time.sleep(600)
"""
_PARENT = f"""
import os, subprocess, sys, time
child = subprocess.Popen([sys.executable, "-c", {_CHILD!r}, str(os.getpid())], stdout=subprocess.PIPE)
assert child.stdout.readline() == b"alive\\n"
print(child.pid, flush=True)
time.sleep(600)
"""


def test_a_child_dies_with_its_parent() -> None:
    with subprocess.Popen([sys.executable, "-c", _PARENT], stdout=subprocess.PIPE) as parent:
        assert parent.stdout is not None
        child = int(parent.stdout.readline())
        assert is_alive(child)
        parent.send_signal(signal.SIGKILL)
        parent.wait()
        while is_alive(child):  # a child that lives on hangs the test
            time.sleep(0.01)


_NICE = """
import os, sys
from pathlib import Path

import pytest
from fastsplat.service.common.process import yield_to_others
yield_to_others(int(sys.argv[1]))
group = Path("/proc/self/autogroup")
print(os.getpriority(os.PRIO_PROCESS, 0), int(group.read_text().split()[-1]) if group.exists() else "none")
"""


@pytest.mark.parametrize("niceness", [0, 7])
def test_a_process_that_leads_a_session_makes_that_as_nice_as_itself(niceness: int) -> None:
    priority = os.getpriority(os.PRIO_PROCESS, 0)
    command = [sys.executable, "-c", _NICE, str(niceness)]
    result = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True, start_new_session=True)
    process, session = result.stdout.split()
    assert int(process) == min(19, priority + niceness) and session in ("none", str(niceness))


def test_modules_load_without_a_collector_which_runs_again_afterwards() -> None:
    """Whatever happens while they load; in a process of its own, as what is frozen stays so."""
    script = """
import gc
from fastsplat.service.common.process import loading_modules
try:
    with loading_modules():
        assert not gc.isenabled()
        made = [[] for _ in range(100_000)]
        raise ImportError
except ImportError:
    pass
assert gc.isenabled() and gc.get_freeze_count() >= len(made), gc.get_freeze_count()
"""
    subprocess.run([sys.executable, "-c", script], check=True)
