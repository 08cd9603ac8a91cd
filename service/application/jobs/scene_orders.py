"""Job requests on finished scenes: an operation, done by a worker."""

from __future__ import annotations

import hashlib
import json
import uuid
from collections.abc import Callable, Mapping
from typing import Any

from fastsplat.service.application.admin.quotas import Quotas
from fastsplat.service.store.codec import options_to_json
from fastsplat.service.store.records import NewJob, OperationRecord
from fastsplat.service.store.store import Store
from fastsplat_contract.errors import ConflictError
from fastsplat_contract.operations import OperationKind, SceneOptions


def order_job(
    kind: OperationKind, scene_id: str, request_id: str, order: Mapping[str, Any], project: str, **more: Any
) -> NewJob:
    """The job that does an order.

    Args:
        kind: of the work, the key of the order in the job's options.
        scene_id: which scene.
        request_id: the same id with the same order is the same operation; "" for none.
        order: what is asked for, as JSON.
        project: whose scene it is.
        **more: what the server adds to the order, which does not tell it from another one.
    """
    content = json.dumps({"scene": scene_id, kind: order}, sort_keys=True)
    return NewJob(
        scene_id=scene_id,
        operation_id=uuid.uuid4().hex,
        name="",
        request_id=request_id,
        request_digest=hashlib.sha256(content.encode()).hexdigest(),
        upload_id="",
        options={**options_to_json(SceneOptions()), kind: {**order, **more}},
        project=project,
    )


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
