"""Handling of database and object store outages: retry or skip."""

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
    """Retries a call for up to ten minutes during an outage."""

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
    """Returns the requests to a job; a database outage only costs progress reports."""
    try:
        return look()
    except DatabaseError as error:
        logger.warning("job %s: %s; will ask again", job_id, error.message)
        return frozenset()
