"""Examples of running jobs and their previews."""

from __future__ import annotations

from datetime import datetime

import numpy as np

from fastsplat_contract.geometry.camera import Camera, PosedCamera
from fastsplat_contract.jobs.job_watching import PlacedCameras, PlacedInfo, Preview, PreviewInfo
from fastsplat_contract.jobs.operations import JobEstimate, Operation, StageProgress

_PLACED = PlacedInfo(1, 60, 60, complete=True)

PREVIEW = Preview(PreviewInfo(4, 1_250, 16.5, 24_000, 24.8, "front.png", 320, 240), b"\xff\xd8\xff")
ESTIMATE = JobEstimate(185.4, {"capture": 23.1, "perception": 33.9, "training": 121.5, "export": 6.9})
PLACED = PlacedCameras(
    _PLACED,
    (PosedCamera(Camera(width=64, height=48, fx=60.0, fy=60.0, cx=32.0, cy=24.0), np.eye(4), "front.png"),),
    bytes(12),
    b"\xc8\x96\x64",
)


def running_operation(operation_id: str, scene_id: str, posted: datetime, updated: datetime) -> Operation:
    """Builds a job in the middle of its second stage."""
    return Operation(
        id=operation_id,
        scene_id=scene_id,
        state="RUNNING",
        done=False,
        created_at=posted,
        updated_at=updated,
        stages=(
            StageProgress("capture", 1.0, "60 of 60 images registered", 41.5, {"registered": 60.0}),
            StageProgress("perception", 0.5, "30 of 60 images labelled", 22.0, {}),
        ),
        error=None,
        attempt=1,
        worker="working",
        seconds_left=310.0,
        placed=_PLACED,
    )
