"""`fastsplat jobs`: list the jobs of all keys, read their logs, end one early, and retry them."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from typing import Annotated, Any, get_args

import typer
from rich import box
from rich.console import Console
from rich.table import Column, Table
from rich.text import Text

from fastsplat.cli.local_service import local_store
from fastsplat.service.settings import load_settings
from fastsplat.service.store.records import SECONDS_LEFT, OperationRecord
from fastsplat_contract.errors import InvalidInputError, NotFoundError
from fastsplat_contract.operations import OperationState

jobs_app = typer.Typer(
    name="jobs",
    help="Training jobs: list them, end one early, read a failed one's log, retry it.",
    no_args_is_help=True,
)

_MAX_LOG = 1 << 20


@jobs_app.command("list")
def list_jobs(
    state: Annotated[str, typer.Option(help="Only those QUEUED, RUNNING, SUCCEEDED, FAILED or CANCELLED.")] = "",
    limit: Annotated[int, typer.Option(min=1, help="At most so many, newest first.")] = 20,
    as_json: Annotated[bool, typer.Option("--json", help="Print a JSON array instead of a table.")] = False,
) -> None:
    """Show the newest jobs."""
    only: OperationState | None = next((known for known in get_args(OperationState) if known == state.upper()), None)
    if state and only is None:
        raise InvalidInputError(
            f"{state[:20]!r} is no state of a job", field="state", hint="See --help for the states."
        )
    with local_store() as store:
        records = store.scenes.list_operations(limit, None, only)
    if as_json:
        typer.echo(json.dumps([_to_json(record) for record in records], indent=2))
        return
    # Ids stand on lines of their own, whole, so that they can be copied from a narrow terminal too.
    headings = (Column("job, and its scene", no_wrap=True), Column("state, posted", no_wrap=True))
    table = Table(*headings, Column("progress", overflow="fold"), box=box.SIMPLE, padding=(0, 1, 0, 0))
    for record in records:
        posted = datetime.fromtimestamp(record.created_at, UTC).strftime("%Y-%m-%d %H:%M:%S")
        table.add_row(f"{record.id}\n{record.scene_id}", f"{record.state}\n{posted}", Text(_progress(record)))
    Console().print(table)


@jobs_app.command()
def log(job_id: Annotated[str, typer.Argument(help="The id from the list.")]) -> None:
    """Print the error of a job, and the end of what its trainers wrote."""
    with local_store() as store:
        record = store.scenes.operation(job_id)
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


@jobs_app.command()
def retry(
    job_id: Annotated[str, typer.Argument(help="The id from the list.")],
    exclude: Annotated[
        list[str] | None, typer.Option(help="A photo of the upload to leave out, as the error names it; repeatable.")
    ] = None,
) -> None:
    """Queue a failed or cancelled job again, with the upload that it had, or without some of its photos."""
    from fastsplat.service.application.service import open_service  # loads what answers questions

    with open_service(load_settings()) as service:
        operation = service.retry_operation(job_id, tuple(exclude or ()))
    typer.echo(f"{operation.id} is {operation.state}")


@jobs_app.command()
def finish(job_id: Annotated[str, typer.Argument(help="The id from the list.")]) -> None:
    """End the training of a job early, and make its scene of what is there."""
    from fastsplat.service.application.service import open_service  # loads what answers questions

    with open_service(load_settings()) as service:
        operation = service.jobs.finish(job_id)
    typer.echo(f"{operation.id} ends its training")


def _progress(record: OperationRecord) -> str:
    counts = f"starts {record.starts}" + (f", priority {record.priority}" if record.priority else "")
    if record.error is not None:
        return f"{counts}\n{record.error['stage']}: {record.error['message']}"
    if not record.stages:
        return counts
    last = record.stages[-1]
    left = last["metrics"].get(SECONDS_LEFT, -1.0) if record.state == "RUNNING" else -1.0
    ending = f"\nabout {left:.0f} s left in all, as of its last report" if left >= 0 else ""
    return f"{counts}\n{last['stage']} {last['fraction']:.0%} {last['message']}{ending}"


def _to_json(record: OperationRecord) -> dict[str, Any]:
    return {
        "id": record.id,
        "scene_id": record.scene_id,
        "state": record.state,
        "created_at": datetime.fromtimestamp(record.created_at, UTC).isoformat(),
        "updated_at": datetime.fromtimestamp(record.updated_at, UTC).isoformat(),
        "starts": record.starts,
        "attempt": record.attempt,
        "again_after": record.again_after,
        "finish_requested": record.finish_requested,
        "priority": record.priority,
        "stages": list(record.stages),
        "error": record.error,
    }
