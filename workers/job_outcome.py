"""Ends of jobs and stages."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal


@dataclass(frozen=True)
class JobOutcome:
    """Outcome of a job or one of its stages; `error` is the `OperationError` of a failed one as JSON, else None."""

    state: Literal["done", "cancelled", "failed"]
    error: Mapping[str, Any] | None = None


DONE = JobOutcome("done")
CANCELLED = JobOutcome("cancelled")


def failed(error: Mapping[str, Any]) -> JobOutcome:
    """The outcome of a job that ended with an error."""
    return JobOutcome("failed", error)
