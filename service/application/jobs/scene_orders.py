"""Job requests on finished scenes: an operation, done by a worker."""

from __future__ import annotations

from collections.abc import Callable

from fastsplat.service.application.admin.quotas import Quotas
from fastsplat.service.store.records import NewJob, OperationRecord
from fastsplat.service.store.store import Store
from fastsplat_contract.errors import ConflictError


def place_order(job: NewJob, store: Store, quotas: Quotas, check: Callable[[], None] = lambda: None) -> OperationRecord:
    """The operation of an order: queued, or the one that the same request queued before. Durable once this returns.

    Args:
        job: see `order_job`.
        store: of the project.
        quotas: of how many jobs may wait or run.
        check: raises where the scene cannot be worked on; not called for an order that was placed before.

    Raises:
        ConflictError: the request id was used before for another request; photos are being withdrawn from the scene; or
            they are to be, and another job works on it.
        QuotaError: as many of the project's jobs wait or run as may.
    """
    earlier = store.scenes.find_request(job.request_id, job.request_digest, job.project)
    if earlier is not None:
        return earlier
    _check_alone(job, store)
    check()
    quotas.check_retry(job.project)
    return store.scenes.add_job(job)


def _check_alone(job: NewJob, store: Store) -> None:
    """Raise where a job would find things in a version of which nothing stays once photos are withdrawn."""
    for other in store.withdrawals.unfinished_jobs(job.scene_id):
        if "withdraw_photos" in job.options or other.kind == "withdraw_photos":
            raise ConflictError(
                f"operation {other.id} ({other.kind}) works on this scene",
                field="scene",
                hint="Wait for it, or cancel it.",
            )
