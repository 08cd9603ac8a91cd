"""One supervisor over the API and a machine's workers, a process a device."""

from __future__ import annotations

import logging
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from fastsplat.service.common.process import PARENT_VARIABLE
from fastsplat.workers.engine.process_group import process_state
from fastsplat_contract.errors import InvalidInputError

logger = logging.getLogger(__name__)
_STEADY_S = 30.0
_MAX_FAST_FAILURES = 4
_DRAIN_S = 30.0
_POLL_S = 0.2
_SUSPENDED_S = 10.0
_MAX_PAUSE_S = 10.0
_AFTER_CRASH_S = 1.0
_FIRST_CRASH_STATUS = 64  # below it, a program says that it cannot run: a wrong setting, a port that is taken


@dataclass(frozen=True)
class Role:
    """A process: its target, and environment variables beyond this process's own."""

    command: Sequence[str]
    environment: Mapping[str, str] = field(default_factory=dict)


def serve(roles: Mapping[str, Role]) -> int:
    """Run one process a role until SIGTERM or SIGINT; one that dies is started again.

    One that stays stopped, as by SIGSTOP, is killed and started again: it may hold the lock that all others wait for.

    Args:
        roles: by name. Their environment names this process in `PARENT_VARIABLE`.

    Returns:
        0 after SIGTERM or SIGINT; 1 if a role exits again and again right after its start. (Crashes do not count: a job
        that crashes its workers is FAILED by them after some starts.)
    """
    stop_requested = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop_requested.set())
    children = [_Child(name, role) for name, role in roles.items()]
    try:
        while not stop_requested.wait(_POLL_S):
            if not all(child.keep_alive() for child in children):
                return 1
        return 0
    finally:
        _stop(children)


class _Child:
    """One role's process, started again when it dies."""

    def __init__(self, name: str, role: Role) -> None:
        self.role = name
        self._command = role.command
        self._environment = role.environment
        self._fast_failures = 0
        self._start_at = 0.0
        self._stopped_at = 0.0
        self._start()

    def keep_alive(self) -> bool:
        """Restarts the process if it died; False if it repeatedly exits right after its start."""
        status = self.process.poll()
        if status is None:
            self._kill_suspended()
            return True
        if not self._start_at:
            fast = time.monotonic() - self._started_at < _STEADY_S
            crash = not 0 <= status < _FIRST_CRASH_STATUS
            self._fast_failures = self._fast_failures + 1 if fast and not crash else 0
            logger.warning("%s ended with status %d", self.role, status)
            if self._fast_failures >= _MAX_FAST_FAILURES:
                logger.error("%s ended %d times right after its start; giving up", self.role, self._fast_failures)
                return False
            pause = _AFTER_CRASH_S if crash and fast else 0.25 * 2**self._fast_failures
            self._start_at = time.monotonic() + min(pause, _MAX_PAUSE_S)
        if time.monotonic() >= self._start_at:
            self._start()
        return True

    def _kill_suspended(self) -> None:
        if process_state(self.process.pid, float("inf")) != "T":
            self._stopped_at = 0.0
            return
        self._stopped_at = self._stopped_at or time.monotonic()
        if time.monotonic() - self._stopped_at > _SUSPENDED_S:
            logger.warning("%s has been stopped for %.0f s and is killed", self.role, _SUSPENDED_S)
            self.process.kill()

    def _start(self) -> None:
        # In a session of its own, so that the terminal's Ctrl-C reaches the supervisor alone and stopping has an order.
        self.process = subprocess.Popen(
            self._command,
            env={**os.environ, **self._environment, PARENT_VARIABLE: str(os.getpid())},
            start_new_session=True,
        )
        self._started_at = time.monotonic()
        self._start_at = self._stopped_at = 0.0
        logger.info("%s runs as process %d", self.role, self.process.pid)


def _stop(children: Sequence[_Child]) -> None:
    for child in children:
        child.process.terminate()
    deadline = time.monotonic() + _DRAIN_S
    for child in children:
        try:
            child.process.wait(timeout=max(0.0, deadline - time.monotonic()))
        except subprocess.TimeoutExpired:
            logger.warning("%s did not stop in %.0f s and is killed", child.role, _DRAIN_S)
            child.process.kill()
            child.process.wait()
        logger.info("%s has stopped", child.role)


_CPU = "cpu"


def worker_roles(devices: str, workers: int, threads_per_job: int) -> Mapping[str, Role]:
    """The workers of this machine, by name.

    Args:
        devices: comma-separated CUDA device numbers or ids, each for workers of its own, or "cpu"; "" leaves the choice
            to CUDA_VISIBLE_DEVICES as it is.
        workers: worker processes a device.
        threads_per_job: the setting; for 0, all workers share the machine's CPUs evenly.

    Raises:
        InvalidInputError: an unknown kind of device, one named twice, or no worker.
    """
    from fastsplat.service.common.setting_groups import environment_variable
    from fastsplat.service.settings import JobSettings

    names = [name.strip() for name in devices.split(",")] if devices else [""]
    invalid = [name for name in names if devices and not re.fullmatch(rf"{_CPU}|\d+|(GPU|MIG)-[\w/-]+", name)]
    if invalid:
        raise InvalidInputError(
            f"{invalid[0][:40]!r} is no device", field="devices", hint='Write e.g. "0,1", "GPU-<id>", or "cpu".'
        )
    if len(set(names)) < len(names):
        raise InvalidInputError("a device is named twice", field="devices", hint="Use --workers for several on one.")
    if workers < 1:
        raise InvalidInputError(f"{workers} workers", field="workers", limit="at least 1")
    count = len(names) * workers
    roles = {}
    for name in names:
        for number in range(1, workers + 1):
            environment = {} if not devices else {"CUDA_VISIBLE_DEVICES": "" if name == _CPU else name}
            if count > 1 and not threads_per_job:
                threads = max(1, len(os.sched_getaffinity(0)) // count)
                environment[environment_variable(JobSettings, "threads_per_job")] = str(threads)
            parts = ["worker", name, str(number) if workers > 1 else ""]
            command = [sys.executable, "-m", "fastsplat.cli.main", "worker"]
            roles["-".join(part for part in parts if part)] = Role(command, environment)
    return roles
