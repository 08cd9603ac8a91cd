"""The calls about one job: how far it is, pictures and cameras while it runs, its end."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastsplat_client.errors import read
from fastsplat_client.thing_calls import in_path
from fastsplat_client.transport import Transport
from fastsplat_contract.camera import PosedCamera
from fastsplat_contract.job_watching import PlacedCameras, PlacedInfo, Preview
from fastsplat_contract.json_codec import to_plain
from fastsplat_contract.operations import Operation, RetryIn


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


class JobCalls:
    """The part of `Client` that speaks of one job."""

    _transport: Transport

    def operation(self, operation_id: str) -> Operation:
        """Where a job stands."""
        return read(Operation, self._transport.call("GET", _job_path(operation_id)))

    def cancel(self, operation_id: str) -> Operation:
        """Ask a job to stop; one that is over stays as it is."""
        return read(Operation, self._transport.call("POST", f"{_job_path(operation_id)}:cancel"))

    def retry(self, operation_id: str, exclude: Sequence[str] = ()) -> Operation:
        """Queue a failed or cancelled job again, with the upload that it had; one in another state stays as it is.

        Args:
            operation_id: which.
            exclude: photos of the upload to leave out, e.g. `Operation.error.photos`, beside those of earlier retries.

        Raises:
            InvalidInputError: the upload has no photo of such a name, or too few are left.
            NotReadyError: photos are to be left out of a job that neither failed nor was cancelled.
        """
        body = to_plain(RetryIn(tuple(exclude)))
        return read(Operation, self._transport.call("POST", f"{_job_path(operation_id)}:retry", json=body))

    def finish(self, operation_id: str) -> Operation:
        """Ask a job to end its training early, and to make the scene of what is there; asked again nothing changes.

        Raises:
            NotReadyError: it does not train right now.
        """
        return read(Operation, self._transport.call("POST", f"{_job_path(operation_id)}:finish"))

    def preview(self, operation_id: str) -> Preview:
        """The newest picture (JPEG) of a scene that is being trained.

        Raises:
            NotFoundError: there is none (any more).
        """
        return read(Preview, self._transport.call("GET", f"{_job_path(operation_id)}/preview"))

    def placed_cameras(self, operation_id: str) -> Placed:
        """The cameras that a job has placed so far, and some of its points.

        Raises:
            NotFoundError: there are none (any more).
        """
        placed = read(PlacedCameras, self._transport.call("GET", f"{_job_path(operation_id)}/cameras"))
        points = np.frombuffer(placed.points, dtype="<f4").astype(np.float32).reshape(-1, 3)
        colors = np.frombuffer(placed.colors, dtype=np.uint8).reshape(-1, 3)
        return Placed(placed.info, placed.cameras, points, colors)


def _job_path(operation_id: str) -> str:
    return f"/v1/operations/{in_path(operation_id)}"
