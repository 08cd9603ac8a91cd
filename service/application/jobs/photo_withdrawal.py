"""Job requests to withdraw photos from finished scenes: checked and queued here, and done by a worker."""

from __future__ import annotations

from dataclasses import replace

from fastsplat.service.application.admin.quotas import Quotas
from fastsplat.service.application.answering.open_scenes import OpenScenes
from fastsplat.service.application.base.validate import check_request_id, check_texts
from fastsplat.service.application.jobs.running_jobs import RunningJobs
from fastsplat.service.application.jobs.scene_orders import place_order
from fastsplat.service.capture.photos.scene_photos import photo_path
from fastsplat.service.settings import Settings
from fastsplat.service.store.codec import options_from_json, options_to_json
from fastsplat.service.store.ordered_jobs import order_job
from fastsplat.service.store.records import NewJob, OperationRecord
from fastsplat.service.store.store import Store
from fastsplat.service.withdrawal_checks import check_retrainable, photos_left
from fastsplat_contract.operations import Operation
from fastsplat_contract.withdrawal_messages import WithdrawPhotosIn


class PhotoWithdrawal:
    """Orders of one project to withdraw photos from its scenes."""

    def __init__(self, store: Store, settings: Settings, scenes: OpenScenes, quotas: Quotas, project: str) -> None:
        self._store, self._scenes, self._quotas, self._project = store, scenes, quotas, project
        self._jobs = RunningJobs(store, settings)

    def order(self, scene_id: str, request: WithdrawPhotosIn) -> Operation:
        """Queue a job that makes a finished scene anew without some of its photos. Durable once this returns.

        Raises:
            NotFoundError: there is no such scene.
            NotReadyError: it is not ready, or cannot be made anew, see `check_retrainable`.
            InvalidInputError: no photos, one that the scene does not have, or too few would be left.
            ConflictError, QuotaError: as `place_order`.
        """
        check_request_id(request.request_id)
        check_texts(request.photos, "photos")
        self._scenes.finished(scene_id)
        maker = self._store.scenes.operation(self._store.scenes.scene(scene_id).operation_id)
        return self._jobs.operation(
            place_order(
                _job_of(scene_id, request, maker, self._project),
                self._store,
                self._quotas,
                lambda: self._check(scene_id, request),
            )
        )

    def _check(self, scene_id: str, request: WithdrawPhotosIn) -> None:
        scene = self._store.scenes.scene(scene_id)
        folder = self._scenes.folder(scene_id, scene.version)
        check_retrainable(scene.quality, folder)
        kept = [row["name"] for number, row in enumerate(scene.every_camera) if photo_path(folder, number).is_file()]
        photos_left(kept, request.photos)


def _job_of(scene_id: str, request: WithdrawPhotosIn, maker: OperationRecord, project: str) -> NewJob:
    """The job that withdraws photos, with the options with which the scene was made."""
    order = {"photos": list(request.photos)}
    job = order_job("withdraw_photos", scene_id, request.request_id, order, project, scene=scene_id)
    options = replace(options_from_json(maker.options), priority=0)
    return replace(job, options={**job.options, **options_to_json(options)})
