"""Calls about jobs: progress, previews, placed cameras, control."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastsplat_client.table_calls import TableCalls
from fastsplat_contract import calls
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.jobs.job_watching import PlacedInfo, Preview, Until
from fastsplat_contract.jobs.operations import JobEstimate, Operation, PresetName
from fastsplat_contract.messages import requests
from fastsplat_contract.messages.scenes import Scene


class Placed(NamedTuple):
    """Cameras that a job has placed so far (some or all), and sparse points."""

    info: PlacedInfo  # their number, and whether they are final
    cameras: tuple[PosedCamera, ...]
    points: NDArray[np.float32]  # [P, 3], scene units
    colors: NDArray[np.uint8]  # [P, 3], RGB


_POLL_S = 0.5


class JobCalls(TableCalls):
    """Job calls of `Client`."""

    def estimate_job(
        self, photos: int, width: int = 0, height: int = 0, *, preset: PresetName | None = None
    ) -> JobEstimate:
        """Estimates the processing time of photos of `width` x `height` pixels (0: unknown)."""
        return self.call(calls.ESTIMATE_JOB, requests.EstimateJobRequest(photos, width, height, preset))

    def wait_for_scene(self, scene_id: str, until: Until = "done") -> Scene:
        """Waits until a scene has reached a stage, or its job has ended.

        Args:
            until: first: a provisional scene can be queried; good: a training draft can be; done: the job has ended.
        """
        while True:
            scene = self.call(calls.GET_SCENE, requests.GetSceneRequest(scene_id))
            stage = None if scene.provisional is None else scene.provisional.stage
            enough = {"first": stage is not None, "good": stage == "training", "done": False}[until]
            if scene.state != "TRAINING" or enough:
                return scene
            time.sleep(_POLL_S)

    def operation(self, operation_id: str) -> Operation:
        """Gets a job."""
        return self.call(calls.GET_OPERATION, requests.GetOperationRequest(operation_id))

    def cancel(self, operation_id: str) -> Operation:
        """Asks a job to stop; has no effect once it has ended."""
        return self.call(calls.CANCEL_OPERATION, requests.CancelOperationRequest(operation_id))

    def retry(self, operation_id: str, exclude: Sequence[str] = ()) -> Operation:
        """Queues a failed or cancelled job again; has no effect in other states.

        Args:
            exclude: photos to leave out, e.g. `Operation.error.photos`, in addition to those of earlier retries.

        Raises:
            InvalidInputError: an excluded photo does not exist, or too few are left.
            NotReadyError: photos are excluded from a job that neither failed nor was cancelled.
        """
        return self.call(calls.RETRY_OPERATION, requests.RetryOperationRequest(operation_id, tuple(exclude)))

    def finish(self, operation_id: str) -> Operation:
        """Ends a job's training early and keeps the result. Raises `NotReadyError` unless it is training."""
        return self.call(calls.FINISH_OPERATION, requests.FinishOperationRequest(operation_id))

    def preview(self, operation_id: str) -> Preview:
        """Gets the newest training picture (JPEG). Raises `NotFoundError` if there is none."""
        return self.call(calls.GET_PREVIEW, requests.GetPreviewRequest(operation_id))

    def placed_cameras(self, operation_id: str) -> Placed:
        """Gets the cameras placed so far and some points. Raises `NotFoundError` if there are none."""
        placed = self.call(calls.GET_PLACED_CAMERAS, requests.GetPlacedCamerasRequest(operation_id))
        points = np.frombuffer(placed.points, dtype="<f4").astype(np.float32).reshape(-1, 3)
        colors = np.frombuffer(placed.colors, dtype=np.uint8).reshape(-1, 3)
        return Placed(placed.info, placed.cameras, points, colors)
