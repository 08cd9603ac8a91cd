"""Waiting at the command line for a job that a worker does."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import typer

from fastsplat_contract.operations import Operation

if TYPE_CHECKING:
    from fastsplat.service.application.service import SceneService

_POLL_S = 0.5


def wait_for(service: SceneService, operation: Operation) -> Operation:
    """The operation once it is done; stages, and why it failed, are lines on stderr meanwhile."""
    shown = ""
    while not operation.done:
        time.sleep(_POLL_S)
        operation = service.get_operation(operation.id)
        line = f"{operation.stages[-1].stage}: {operation.stages[-1].message}" if operation.stages else ""
        if line != shown:
            typer.echo(line, err=True)
        shown = line
    if operation.error is not None:
        hint = operation.error.details.get("hint", "")
        typer.echo(f"{operation.error.reason}: {operation.error.message}. {hint}".strip(), err=True)
    return operation
