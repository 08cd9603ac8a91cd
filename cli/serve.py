"""One supervisor over the API and the worker of one machine."""

from __future__ import annotations

import logging
import os
import signal
import subprocess
import threading
import time
from collections.abc import Mapping, Sequence

from workers.lifeline import PARENT_VARIABLE

logger = logging.getLogger(__name__)
_STEADY_S = 30.0
_MOST_FAST_FAILURES = 4
_DRAIN_S = 30.0
_POLL_S = 0.2


def serve(commands: Mapping[str, Sequence[str]]) -> int:
    """Run one process a role until SIGTERM or SIGINT; one that dies is started again.

    Args:
        commands: the command line of each role. Its environment names this process in `PARENT_VARIABLE`.

    Returns:
        0 after a wanted stop; 1 if a role dies again and again right after its start.
    """
    wanted = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: wanted.set())
    children = [_Child(role, command) for role, command in commands.items()]
    try:
        while not wanted.wait(_POLL_S):
            if not all(child.keep_alive() for child in children):
                return 1
        return 0
    finally:
        _stop(children)


class _Child:
    """One role's process, with what its deaths have taught."""

    def __init__(self, role: str, command: Sequence[str]) -> None:
        self.role = role
        self._command = command
        self._fast_failures = 0
        self._start_at = 0.0
        self._start()

    def keep_alive(self) -> bool:
        """Start the process again if it died. False when that has become pointless."""
        status = self.process.poll()
        if status is None:
            return True
        if not self._start_at:
            fast = time.monotonic() - self._started_at < _STEADY_S
            self._fast_failures = self._fast_failures + 1 if fast else 0
            logger.warning("%s ended with status %d", self.role, status)
            if self._fast_failures >= _MOST_FAST_FAILURES:
                logger.error("%s ended %d times right after its start; giving up", self.role, self._fast_failures)
                return False
            self._start_at = time.monotonic() + min(0.25 * 2**self._fast_failures, 10.0)
        if time.monotonic() >= self._start_at:
            self._start()
        return True

    def _start(self) -> None:
        # In a session of its own, so that the terminal's Ctrl-C reaches the supervisor alone and stopping has an order.
        self.process = subprocess.Popen(
            self._command,
            env={**os.environ, PARENT_VARIABLE: str(os.getpid())},
            start_new_session=True,
        )
        self._started_at = time.monotonic()
        self._start_at = 0.0
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
