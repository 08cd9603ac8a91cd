"""Starts, reads and kills trainer processes."""

from __future__ import annotations

import contextlib
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from fastsplat.service.common.process import PARENT_VARIABLE
from fastsplat.service.common.setting_groups import environment_variable
from fastsplat.service.settings import Settings
from fastsplat.workers.job.protocol import Event, Job, read_event

# The kernel's death signal is bound to the forking thread, so one that never ends forks all trainers.
_forker = ThreadPoolExecutor(1, thread_name_prefix="forker")
_GRACE_S = 2.0


class TrainerProcess:
    """A running trainer with its process group and events."""

    def __init__(self, job: Job, run: str, log: Path, *, asks_namer: bool = False) -> None:
        log.parent.mkdir(parents=True, exist_ok=True)
        self._process = _forker.submit(_start, job, log).result()
        self._events: queue.SimpleQueue[Event | None] = queue.SimpleQueue()
        self._ended_at: float | None = None
        self._finish_mark = job.finish_mark
        threading.Thread(target=self._read, name=f"events of {job.operation_id}", daemon=True).start()
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # died already; see its exit status
            self._process.stdin.write(job.to_line(run, asks_namer=asks_namer))
            self._process.stdin.flush()

    @property
    def pid(self) -> int:
        """Id of the process and of its group."""
        return self._process.pid

    def next(self, timeout: float) -> Event | None:
        """Returns the next event, or None after `timeout` seconds; EOFError after the last."""
        try:
            event = self._events.get(timeout=timeout)
        except queue.Empty:
            # A stray grandchild may hold the pipe open after the trainer's death; do not wait for it.
            if self._process.poll() is not None:
                self._ended_at = self._ended_at or time.monotonic()
                if time.monotonic() - self._ended_at > _GRACE_S:
                    raise EOFError from None
            return None
        if event is None:
            self._events.put(None)
            raise EOFError
        return event

    def ask_to_finish(self) -> None:
        """Requests an early end of training, also of later attempts; repeated at each poll."""
        with contextlib.suppress(OSError):
            self._finish_mark.touch()

    def status(self) -> str:
        """Describes how the process ended, after `next` raised EOFError."""
        try:
            code = self._process.wait(timeout=_GRACE_S)
        except subprocess.TimeoutExpired:
            return "it closed its pipe and did not end"
        if code >= 0:
            return f"it left with exit status {code}"
        name = signal.Signals(-code).name
        why = ", most often the kernel's out-of-memory killer" if name == "SIGKILL" else ""
        return f"it was killed by {name}{why}"

    def kill(self) -> None:
        """Kills the process group; idempotent."""
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self._process.pid, signal.SIGKILL)
        if self._process.stdin is not None:
            with contextlib.suppress(OSError):
                self._process.stdin.close()
        self._process.wait()

    def _read(self) -> None:
        assert self._process.stdout is not None
        with self._process.stdout as stream:
            for line in stream:
                with contextlib.suppress(ValueError, TypeError):  # a line cut off by the process's death
                    self._events.put(read_event(line))
        self._events.put(None)


def _start(job: Job, log: Path) -> subprocess.Popen[bytes]:
    environment = {**os.environ, PARENT_VARIABLE: str(os.getpid()), "OMP_WAIT_POLICY": "passive"}
    # A trainer reads untrusted data, and needs no database or object store. The job carries the namer's settings.
    secrets = tuple(environment_variable(Settings, name) for name in ("database_url", "database_password", "namer"))
    for name in list(environment):
        if name.startswith((*secrets, "AWS_")):
            del environment[name]
    if job.settings.jobs.threads_per_job:
        environment["OMP_NUM_THREADS"] = str(job.settings.jobs.threads_per_job)
    with log.open("ab") as stderr:
        return subprocess.Popen(
            [sys.executable, "-m", "fastsplat.workers.engine.trainer"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=stderr,
            env=environment,
            start_new_session=True,
        )
