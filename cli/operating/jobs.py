"""`fastsplat jobs`: list, watch, end, cancel and retry jobs, and read their logs."""

from __future__ import annotations

from itertools import islice
from typing import Annotated

import typer

from fastsplat.cli.options import JobId, Watch, service_command
from fastsplat.cli.session import Session
from fastsplat.cli.short_ids import SHORT
from fastsplat.cli.tables import Column, facts, minute, table
from fastsplat.service.library.job_lines import progress
from fastsplat_contract.jobs.operations import JobAttempt, Operation, OperationList, OperationState
from fastsplat_contract.messages.projects import GetJobLogRequest

jobs_app = typer.Typer(
    help="Jobs, which train scenes: list, show, watch, end, cancel and retry them, read logs.", no_args_is_help=True
)


@service_command(jobs_app, "list")
def list_jobs(
    session: Session,
    state: Annotated[
        OperationState | None, typer.Option(case_sensitive=False, help="Only those in this state.")
    ] = None,
    limit: Annotated[int | None, typer.Option(min=1, help="Only the newest so many. Default: all.")] = None,
) -> None:
    """Show the jobs, newest first."""
    jobs = tuple(islice(session.client.operations(state), limit))
    columns = (Column("job"), Column("scene"), Column("state"), Column("posted"), Column("progress", "cut"))
    rows = [(job.id[:SHORT], job.scene_id[:SHORT], job.state, minute(job.created_at), _progress(job)) for job in jobs]
    session.tell(OperationList(jobs, ""), table(columns, rows), nothing="there is no such job" if state else "no jobs")


@service_command(jobs_app)
def show(session: Session, job: JobId) -> None:
    """Show where a job stands, and why it failed if it did."""
    operation = session.client.operation(session.job(job))
    session.tell(operation, _facts(operation))


@service_command(jobs_app)
def watch(session: Session, job: JobId) -> None:
    """Follow a job to its end; status 1 if it fails."""
    session.tell_job(session.client.operation(session.job(job)), _facts, watch=True)


@service_command(jobs_app)
def cancel(session: Session, job: JobId) -> None:
    """Stop a job without keeping a result; its upload stays a while for a retry."""
    operation = session.client.cancel(session.job(job))
    stops = "" if operation.done else "; it stops soon"
    session.tell(operation, f"job {operation.id} is {operation.state}{stops}")


@service_command(jobs_app)
def finish(session: Session, job: JobId) -> None:
    """End the training of a job early, and make its scene of what is there."""
    operation = session.client.finish(session.job(job))
    session.tell(operation, f"job {operation.id} ends its training")


@service_command(jobs_app)
def retry(
    session: Session,
    job: JobId,
    exclude: Annotated[
        list[str], typer.Option(metavar="PHOTO", help="To leave out, as the job's error names it; repeatable.")
    ] = [],
    watch: Watch = False,
) -> None:
    """Queue a failed or cancelled job again, with all of its photos or without some."""
    session.tell_job(session.client.retry(session.job(job), exclude), _facts, watch=watch)


@service_command(jobs_app)
def log(session: Session, job: JobId) -> None:
    """Print the end of a job's log; on stderr, why the job failed."""
    job_id = session.job(job)
    error = session.client.operation(job_id).error
    from fastsplat_contract import calls  # every message of the contract

    written = session.client.call(calls.GET_JOB_LOG, GetJobLogRequest(job_id)).log
    if error is not None and not session.as_json:
        typer.echo(f"{error.stage}: {error.reason}: {error.message}", err=True)
    session.tell({"error": error, "log": written}, written.rstrip("\n"))


def _facts(job: Operation) -> str:
    error = job.error
    return facts(
        (
            ("job", job.id),
            ("scene", job.scene_id),
            ("does", job.kind.replace("_", " ")),
            ("state", job.state + (", ends its training" if job.finish_requested and not job.done else "")),
            ("posted", minute(job.created_at)),
            ("changed", minute(job.updated_at)),
            *(("attempt", _attempt(attempt)) for attempt in job.attempts),
            ("worker", job.worker or ""),
            ("progress", "" if job.done else progress(job)),
            ("failed", progress(job) if error is not None else ""),
            ("photos", ", ".join(error.photos) if error is not None else ""),
            *(("left out", f"{name}: {reason}") for name, reason in job.left_out.items()),
        )
    )


def _attempt(attempt: JobAttempt) -> str:
    began, ended = minute(attempt.began_at), "" if attempt.ended_at is None else f" to {minute(attempt.ended_at)}"
    why = "" if attempt.why is None else f", {attempt.why.replace('_', ' ')}"
    return f"{attempt.number}: {began}{ended}{why}" + (f" ({attempt.worker})" if attempt.worker else "")


def _progress(job: Operation) -> str:
    """As `progress`, short: of an error the sentence alone."""
    if job.error is not None:
        return f"{job.error.stage}: {job.error.message}"
    return "" if job.done or not job.stages else progress(job)
