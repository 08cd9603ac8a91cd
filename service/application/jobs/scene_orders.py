"""Job requests on finished scenes: an operation, done by a worker."""

from __future__ import annotations

from fastsplat.service.application.admin.quotas import Quotas
from fastsplat.service.store.rows.records import NewJob, OperationRecord
from fastsplat.service.store.store import Store


def place_order(job: NewJob, store: Store, quotas: Quotas) -> OperationRecord:
    """The operation of an order: queued, or the one that the same request queued before. Durable once this returns.

    Args:
        job: see `order_job`.
        store: of the project.
        quotas: of how many jobs may wait or run.

    Raises:
        ConflictError: the request id was used before for another request.
        QuotaError: as many of the project's jobs wait or run as may.
    """
    earlier = store.scenes.find_request(job.request_id, job.request_digest, job.project)
    if earlier is not None:
        return earlier
    quotas.check_retry(job.project)
    return store.scenes.add_job(job)
