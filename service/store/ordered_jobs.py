"""Jobs on finished scenes as they are ordered."""

from __future__ import annotations

import hashlib
import json
import uuid
from collections.abc import Mapping
from typing import Any

from fastsplat.service.store.codec import options_to_json
from fastsplat.service.store.records import NewJob
from fastsplat_contract.operations import OperationKind, SceneOptions


def order_job(kind: OperationKind, scene_id: str, request_id: str, order: Mapping[str, Any], project: str) -> NewJob:
    """The job that does an order.

    Args:
        kind: of the work, the key of the order in the job's options.
        request_id: the same id with the same order is the same operation; "" for none.
        order: what is asked for, as JSON.
        project: whose scene it is.
    """
    content = json.dumps({"scene": scene_id, kind: order}, sort_keys=True)
    return NewJob(
        scene_id=scene_id,
        operation_id=uuid.uuid4().hex,
        name="",
        request_id=request_id,
        request_digest=hashlib.sha256(content.encode()).hexdigest(),
        upload_id="",
        options={**options_to_json(SceneOptions()), kind: dict(order)},
        project=project,
    )
