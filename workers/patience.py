"""Calls that wait while the database or the object store is away."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

from fastsplat_contract.errors import DatabaseError, ObjectStoreError

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
