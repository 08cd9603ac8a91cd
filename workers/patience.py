"""Calls while the database or the object store is away: those that wait, and those that do not."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

from fastsplat.service.store.claims import JobRequest
from fastsplat_contract.errors import DatabaseError, ObjectStoreError

logger = logging.getLogger(__name__)

T = TypeVar("T")
P = ParamSpec("P")
_PATIENCE_S = 600.0
_RETRY_S = 1.0


def patient(method: Callable[P, T]) -> Callable[P, T]:
    """Repeat a call for up to ten minutes while the database or the object store does not answer."""

    @wraps(method)
    def call(*args: P.args, **kwargs: P.kwargs) -> T:
        deadline = time.monotonic() + _PATIENCE_S
        while True:
            try:
                return method(*args, **kwargs)
            except (DatabaseError, ObjectStoreError):
                if time.monotonic() > deadline:
                    raise
                time.sleep(_RETRY_S)

    return call


def at_once(job_id: str, look: Callable[[], frozenset[JobRequest]]) -> frozenset[JobRequest]:
    """What `look` says was asked of a job; nothing while the database does not answer: one that restarts in the middle
    of a job costs some progress reports, not the job."""
    try:
        return look()
    except DatabaseError as error:
        logger.warning("job %s: %s; will ask again", job_id, error.message)
        return frozenset()
