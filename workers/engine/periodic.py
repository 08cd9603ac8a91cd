"""Periodic tasks of a worker with rate-limited logging."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable

from sqlalchemy.exc import DBAPIError

from fastsplat_contract.errors import ConflictError, DatabaseError, ObjectStoreError

_PAUSE_AFTER_ERROR_S = 1.0


class RepeatFilter(logging.Filter):
    """Drops records whose first `length` characters passed within `interval_s` seconds."""

    def __init__(self, interval_s: float, length: int) -> None:
        super().__init__()
        self._interval_s = interval_s
        self._length = length
        self._passed_at: dict[str, float] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        beginning, now = record.getMessage()[: self._length], time.monotonic()
        if now - self._passed_at.get(beginning, -self._interval_s) < self._interval_s:
            return False
        self._passed_at[beginning] = now
        return True


logger = logging.getLogger(__name__)
logger.addFilter(RepeatFilter(interval_s=60.0, length=200))


def repeat(name: str, task: Callable[[], None], interval_s: float) -> None:
    """Starts a daemon thread that calls `task` with pauses of `interval_s` seconds."""
    threading.Thread(target=_repeat, args=(name, task, interval_s), name=name, daemon=True).start()


def run_logged(name: str, task: Callable[[], None]) -> bool:
    """Calls `task`, logs its errors, and returns True on success.

    Outages and foreign stores are logged as a line each minute; other errors are defects, with traceback.
    """
    try:
        task()
        return True
    except (DatabaseError, ObjectStoreError, ConflictError, DBAPIError, ConnectionError) as error:
        logger.warning("%s: %s", name, getattr(error, "message", type(error).__name__))
    except Exception as error:
        logger.exception("%s failed with %s", name, type(error).__name__)
    return False


def _repeat(name: str, task: Callable[[], None], interval_s: float) -> None:
    while True:
        if not run_logged(name, task):
            time.sleep(_PAUSE_AFTER_ERROR_S)
        time.sleep(interval_s)
