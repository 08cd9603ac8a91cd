"""Who makes the call that the running task, or the thread it started, serves."""

from __future__ import annotations

from contextvars import ContextVar
from dataclasses import dataclass


@dataclass(frozen=True)
class Principal:
    """Who calls: a key's id, "" where keys are switched off."""

    key_id: str


current_principal: ContextVar[Principal | None] = ContextVar("current_principal", default=None)
"""None where no key was asked for."""


def caller_id() -> str:
    """The id of the key behind the current call; "" without keys."""
    principal = current_principal.get()
    return principal.key_id if principal is not None else ""
