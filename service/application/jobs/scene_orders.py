"""Queueing of jobs on finished scenes."""

from __future__ import annotations

from fastsplat.service.application.answering.project_context import ProjectContext
from fastsplat.service.store.rows.records import NewJob, OperationRecord


def place_order(job: NewJob, context: ProjectContext) -> OperationRecord:
    """Queues a job, or returns the operation of the same earlier request. Durable on return.

    Raises:
        ConflictError: the request id was used for another request.
        QuotaError: too many active jobs in the project.
    """
    earlier = context.store.scenes.find_request(job.request_id, job.request_digest, job.project)
    if earlier is not None:
        return earlier
    context.quotas.check_retry(job.project)
    return context.store.scenes.add_job(job)
