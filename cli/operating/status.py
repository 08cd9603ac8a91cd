"""`fastsplat status`: a server's abilities, its health, and a project's quotas."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

import typer

from fastsplat.cli.lazy_settings import load_settings
from fastsplat.cli.session import Session
from fastsplat.cli.tables import facts, minute, size
from fastsplat.service.library.job_lines import duration
from fastsplat_contract.server.server_status import ModelStatus, QuotaStatus, ServerHealth, ServerStatus, WorkerHealth

if TYPE_CHECKING:
    from fastsplat.service.settings import Settings

_TIMEOUT_S = 5.0


def status(
    session: Session,
    here: Annotated[
        Literal["api", "worker"] | None,
        typer.Option(
            help="Check this host's service: status 0 without output, or 1 with the reason. For containers and "
            "service managers."
        ),
    ] = None,
) -> None:
    """Show the server's abilities and the project's quotas; to operators also its health."""
    if here is not None:
        settings = load_settings()
        if problem := _api_problem(settings) if here == "api" else _worker_problem(settings):
            typer.echo(problem, err=True)
            raise typer.Exit(1)
        return
    server = session.client.server_status()
    session.tell(server, _facts(server))


def _facts(server: ServerStatus) -> str:
    backend = f", which train with {server.training_backend}"
    return facts(
        (
            ("release", server.version),
            ("project", f"{server.project}, as {server.role}"),
            ("key", "" if server.key_expires_at is None else f"expires {minute(server.key_expires_at)}"),
            ("workers", f"{server.workers}{backend}" if server.workers else "none: jobs wait"),
            *(_health(server.health) if server.health is not None else ()),
            ("answers", f"are drawn with {server.backend}"),
            *((model.role.replace("_", " "), _model(model)) for model in server.models),
            *((quota.kind, _quota(quota)) for quota in server.quotas),
            ("upload", f"at most {size(server.max_upload_bytes)} and {server.max_images} images"),
            ("page", " ".join(server.addresses)),
        )
    )


def _health(health: ServerHealth) -> tuple[tuple[str, str], ...]:
    workers = (("worker", _worker(worker)) for worker in health.workers)
    queue, disk = health.queue, health.disk
    longest = "" if queue.waits_s is None else f", the longest for {duration(queue.waits_s)}"
    waiting = f"{queue.waiting:,} wait{longest}; {queue.running:,} run"
    refused = "are refused" if disk.free_bytes < disk.floor_bytes else f"stop below {size(disk.floor_bytes)}"
    free = f"{size(disk.free_bytes)} of {size(disk.total_bytes)} free; uploads {refused}"
    return (*workers, ("queue", waiting), ("disk", free))


def _worker(worker: WorkerHealth) -> str:
    silent = duration(worker.silent_s)
    heard = f"alive, heard {silent} ago" if worker.alive else f"silent for {silent}: other workers get its jobs"
    return f"process {worker.pid} of {worker.host}: {heard}"


def _model(model: ModelStatus) -> str:
    if model.state == "unset":
        return "none"
    uncalibrated = ", not calibrated" if model.calibrated is False else ""
    return f"{model.name}: {model.state}{uncalibrated}"


def _quota(quota: QuotaStatus) -> str:
    text_of = size if quota.kind == "bytes" else "{:,.0f}".format
    return text_of(quota.used) + ("" if quota.limit is None else f" of {text_of(quota.limit)}")


def _api_problem(settings: Settings) -> str:
    import ssl
    import urllib.error
    import urllib.request

    encrypted = settings.tls_cert is not None
    url = f"http{'s' if encrypted else ''}://127.0.0.1:{settings.http_port}/readyz"
    # The certificate names the host that clients know, not this loopback address.
    context = ssl._create_unverified_context() if encrypted else None
    try:
        with urllib.request.urlopen(url, timeout=_TIMEOUT_S, context=context):
            return ""
    except (urllib.error.URLError, OSError) as error:
        return f"{url} does not answer: {error}"


def _worker_problem(settings: Settings) -> str:
    from fastsplat.service.store.store import open_store
    from fastsplat.workers.engine.process_group import machine_id

    store = open_store(settings.data_dir, settings.database_url, settings.artefacts)
    try:
        timeout_s = settings.jobs.stalled_worker_timeout_s
        if store.workers.alive(timeout_s, machine_id()):
            return ""
        return f"no worker of this machine had a heartbeat in the last {timeout_s:.0f} s"
    finally:
        store.close()
