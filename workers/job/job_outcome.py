"""Outcomes of jobs and stages."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal


@dataclass(frozen=True)
class JobOutcome:
    """Outcome of a job or stage."""

    state: Literal["done", "cancelled", "failed"]
    error: Mapping[str, Any] | None = None  # `OperationError` as JSON if failed


DONE = JobOutcome("done")
CANCELLED = JobOutcome("cancelled")


def failed(error: Mapping[str, Any]) -> JobOutcome:
    return JobOutcome("failed", error)
