"""`fastsplat jobs`: what an operator wants to see of jobs, whoever's they are."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from typing import Annotated, get_args

import typer
from rich.console import Console
from rich.table import Table

from fastsplat.service.settings import load_settings
from fastsplat.service.store import Store, open_store
from fastsplat.service.store.records import OperationRecord
from fastsplat_contract.errors import InvalidInputError, NotFoundError
from fastsplat_contract.operations import OperationState

jobs_app = typer.Typer(name="jobs", help="Training jobs: list them, read a failed one's log.", no_args_is_help=True)

_MAX_LOG = 1 << 20


@jobs_app.command("list")
def list_jobs(
    state: Annotated[str, typer.Option(help="Only those QUEUED, RUNNING, SUCCEEDED, FAILED or CANCELLED.")] = "",
    limit: Annotated[int, typer.Option(min=1, help="At most so many, newest first.")] = 20,
) -> None:
    """Show the newest jobs."""
    wanted: OperationState | None = next((known for known in get_args(OperationState) if known == state.upper()), None)
    if state and wanted is None:
        raise InvalidInputError(f"no job is ever {state[:20]!r}", field="state", hint="See --help for the states.")
    with _store() as store:
        records = store.rows.operations(limit, None, wanted)
    table = Table(title="Jobs")
    for heading in ("id", "scene", "state", "posted", "starts", "priority", "where it stands"):
        table.add_column(heading, overflow="fold")
    for record in records:
        moment = datetime.fromtimestamp(record.created_at, UTC).strftime("%Y-%m-%d %H:%M:%S")
        numbers = (str(record.starts), str(record.priority))
        table.add_row(record.id, record.scene_id, record.state, moment, *numbers, _standing(record))
    Console().print(table)


@jobs_app.command()
def log(job_id: Annotated[str, typer.Argument(help="The id from the list.")]) -> None:
    """Print the error of a job, and the end of what its trainers wrote."""
    with _store() as store:
        record = store.rows.operation(job_id)
        path = store.blobs.log(record.id)
    if record.error is not None:
        typer.echo(json.dumps(record.error, indent=2), err=True)
    try:
        with path.open("rb") as file:
            file.seek(max(0, path.stat().st_size - _MAX_LOG))
            typer.echo(file.read().decode(errors="replace"), nl=False)
    except FileNotFoundError:
        raise NotFoundError(
            f"job {record.id} has no log on this machine",
            field="job_id",
            hint="Logs are kept on the machine of the worker, of jobs that run or failed, for a while.",
        ) from None


@contextmanager
def _store() -> Iterator[Store]:
    settings = load_settings()
    store = open_store(settings.data_dir, settings.database_url)
    try:
        yield store
    finally:
        store.close()


def _standing(record: OperationRecord) -> str:
    if record.error is not None:
        return f"{record.error['stage']}: {record.error['message']}"
    if not record.stages:
        return ""
    last = record.stages[-1]
    return f"{last['stage']} {last['fraction']:.0%} {last['message']}"
