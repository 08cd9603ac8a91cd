"""Periodic tasks of a worker, and a log that they cannot flood."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable

from sqlalchemy.exc import DBAPIError

from fastsplat_contract.errors import ConflictError, DatabaseError, ObjectStoreError

_PAUSE_AFTER_ERROR_S = 1.0


class RepeatFilter(logging.Filter):
    """Log filter that drops a record whose message begins like one that passed a moment ago.

    Args:
        interval_s: how long a beginning is remembered.
        length: characters of the beginning.
    """

    def __init__(self, interval_s: float, length: int) -> None:
        super().__init__()
        self._interval_s = interval_s
        self._length = length
        self._passed_at: dict[str, float] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether the record is logged."""
        beginning, now = record.getMessage()[: self._length], time.monotonic()
        if now - self._passed_at.get(beginning, -self._interval_s) < self._interval_s:
            return False
        self._passed_at[beginning] = now
        return True


logger = logging.getLogger(__name__)
logger.addFilter(RepeatFilter(interval_s=60.0, length=200))


def repeat(name: str, task: Callable[[], None], interval_s: float) -> None:
    """Start a thread that calls `task` as long as the process lives, with `interval_s` seconds between its calls."""
    threading.Thread(target=_repeat, args=(name, task, interval_s), name=name, daemon=True).start()


def run_logged(name: str, task: Callable[[], None]) -> bool:
    """Call `task` once; what it raises is logged, and the same is not logged again for a minute.

    A database or an object store that is away, or that is another's, is a line; anything else is a defect, and logged
    with its traceback.

    Returns:
        Whether it ended without an error.
    """
    try:
        task()
        return True
    except (DatabaseError, ObjectStoreError, ConflictError, DBAPIError) as error:
        logger.warning("%s: %s", name, getattr(error, "message", type(error).__name__))
    except Exception as error:
        logger.exception("%s failed with %s", name, type(error).__name__)
    return False


def _repeat(name: str, task: Callable[[], None], interval_s: float) -> None:
    while True:
        if not run_logged(name, task):
            time.sleep(_PAUSE_AFTER_ERROR_S)
        time.sleep(interval_s)
