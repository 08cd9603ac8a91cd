"""Queueing of jobs on finished scenes."""

from __future__ import annotations

from fastsplat.service.application.admin.quotas import Quotas
from fastsplat.service.store.rows.records import NewJob, OperationRecord
from fastsplat.service.store.store import Store


def place_order(job: NewJob, store: Store, quotas: Quotas) -> OperationRecord:
    """Queues a job, or returns the operation of the same earlier request. Durable on return.

    Raises:
        ConflictError: the request id was used for another request.
        QuotaError: too many active jobs in the project.
    """
    earlier = store.scenes.find_request(job.request_id, job.request_digest, job.project)
    if earlier is not None:
        return earlier
    quotas.check_retry(job.project)
    return store.scenes.add_job(job)
