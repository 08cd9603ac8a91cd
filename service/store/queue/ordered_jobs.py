"""Creation of jobs on finished scenes."""

from __future__ import annotations

import hashlib
import json
import uuid
from collections.abc import Mapping
from typing import Any

from fastsplat.service.store.rows.codec import options_to_json
from fastsplat.service.store.rows.records import NewJob
from fastsplat_contract.jobs.operations import OperationKind, SceneOptions


def order_job(kind: OperationKind, scene_id: str, request_id: str, order: Mapping[str, Any], project: str) -> NewJob:
    """Builds the job that carries out an order on a scene.

    Args:
        request_id: idempotency key; "" for none.
        order: the request as JSON.
        project: the scene's project.
    """
    content = json.dumps({"scene": scene_id, kind: order}, sort_keys=True)
    return NewJob(
        scene_id=scene_id,
        operation_id=uuid.uuid4().hex,
        name="",
        request_id=request_id,
        request_digest=hashlib.sha256(content.encode()).hexdigest(),
        upload_id="",
        options=options_to_json(SceneOptions()),
        kind=kind,
        order=dict(order),
        project=project,
    )
