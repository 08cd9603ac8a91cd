"""The calls about one job: how far it is, pictures and cameras while it runs, its end."""

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
    """The cameras that a job has placed so far.

    Attributes:
        info: how many, and whether they stay as they are.
        cameras: some or all of them.
        points: float32 [P, 3] of the sparse points, scene units.
        colors: uint8 [P, 3], RGB.
    """

    info: PlacedInfo
    cameras: tuple[PosedCamera, ...]
    points: NDArray[np.float32]
    colors: NDArray[np.uint8]


_POLL_S = 0.5


class JobCalls(TableCalls):
    """The part of `Client` that speaks of one job."""

    def estimate_job(
        self, photos: int, width: int = 0, height: int = 0, *, preset: PresetName | None = None
    ) -> JobEstimate:
        """How long so many photos, of `width` x `height` pixels if that is known, would take to become a scene."""
        return self.call(calls.ESTIMATE_JOB, requests.EstimateJobRequest(photos, width, height, preset))

    def wait_for_scene(self, scene_id: str, until: Until = "done") -> Scene:
        """The scene as soon as it is so far, or its job has ended, whichever way.

        Args:
            until: first: anything can be asked; good: a draft of the training can be; done: nothing more comes.
        """
        while True:
            scene = self.call(calls.GET_SCENE, requests.GetSceneRequest(scene_id))
            stage = None if scene.provisional is None else scene.provisional.stage
            enough = {"first": stage is not None, "good": stage == "training", "done": False}[until]
            if scene.state != "TRAINING" or enough:
                return scene
            time.sleep(_POLL_S)

    def operation(self, operation_id: str) -> Operation:
        """Where a job stands."""
        return self.call(calls.GET_OPERATION, requests.GetOperationRequest(operation_id))

    def cancel(self, operation_id: str) -> Operation:
        """Ask a job to stop; one that is over stays as it is."""
        return self.call(calls.CANCEL_OPERATION, requests.CancelOperationRequest(operation_id))

    def retry(self, operation_id: str, exclude: Sequence[str] = ()) -> Operation:
        """Queue a failed or cancelled job again, with the upload that it had; one in another state stays as it is.

        Args:
            exclude: photos of the upload to leave out, e.g. `Operation.error.photos`, beside those of earlier retries.

        Raises:
            InvalidInputError: the upload has no photo of such a name, or too few are left.
            NotReadyError: photos are to be left out of a job that neither failed nor was cancelled.
        """
        return self.call(calls.RETRY_OPERATION, requests.RetryOperationRequest(operation_id, tuple(exclude)))

    def finish(self, operation_id: str) -> Operation:
        """Ask a job to end its training early, and to make the scene of what is there; asked again nothing changes.

        Raises:
            NotReadyError: it does not train right now.
        """
        return self.call(calls.FINISH_OPERATION, requests.FinishOperationRequest(operation_id))

    def preview(self, operation_id: str) -> Preview:
        """The newest picture (JPEG) of a scene that is being trained.

        Raises:
            NotFoundError: there is none (any more).
        """
        return self.call(calls.GET_PREVIEW, requests.GetPreviewRequest(operation_id))

    def placed_cameras(self, operation_id: str) -> Placed:
        """The cameras that a job has placed so far, and some of its points.

        Raises:
            NotFoundError: there are none (any more).
        """
        placed = self.call(calls.GET_PLACED_CAMERAS, requests.GetPlacedCamerasRequest(operation_id))
        points = np.frombuffer(placed.points, dtype="<f4").astype(np.float32).reshape(-1, 3)
        colors = np.frombuffer(placed.colors, dtype=np.uint8).reshape(-1, 3)
        return Placed(placed.info, placed.cameras, points, colors)
