"""Job requests to ask the server's namer about a finished scene: checked and queued here, and done by a worker."""

from __future__ import annotations

from fastsplat.service.application.admin.quotas import Quotas
from fastsplat.service.application.admin.server_capabilities import agree_to_namer, namer_status, the_namer
from fastsplat.service.application.answering.open_scenes import OpenScenes
from fastsplat.service.application.base.validate import check_request_id
from fastsplat.service.application.jobs.running_jobs import RunningJobs
from fastsplat.service.application.jobs.scene_orders import place_order
from fastsplat.service.settings import Settings
from fastsplat.service.store.ordered_jobs import order_job
from fastsplat.service.store.store import Store
from fastsplat_contract.errors import PermissionDeniedError
from fastsplat_contract.name_suggestions import NamerStatus
from fastsplat_contract.operations import Operation


class OwnNamer:
    """The server's namer for one project. Every method is safe from any thread."""

    def __init__(self, store: Store, settings: Settings, scenes: OpenScenes, quotas: Quotas, project: str) -> None:
        self._store, self._settings, self._scenes = store, settings, scenes
        self._quotas, self._project = quotas, project
        self._jobs = RunningJobs(store, settings)

    def agree(self, host: str) -> NamerStatus:
        """See `agree_to_namer`."""
        return agree_to_namer(self._store, self._settings, self._project, host)

    def order(self, scene_id: str, request_id: str = "") -> Operation:
        """Queue a job that asks it about all things without a name, and suggests what it says as one version; where it
        says nothing usable there is none. Durable once this returns.

        Args:
            scene_id: which scene.
            request_id: the same id returns the same operation; "" for none.

        Raises:
            NotFoundError, NotReadyError: there is no such scene, or it is not ready.
            ModelUnavailableError: the server has no namer.
            PermissionDeniedError: the project did not agree to its host.
            ConflictError, QuotaError: as `place_order`.
        """
        check_request_id(request_id)
        self._scenes.finished(scene_id)
        host = the_namer(self._settings).host
        status = namer_status(self._store, self._settings, self._project)
        if status is None or not status.agreed:
            raise PermissionDeniedError(
                f"the project did not agree that pictures of its things go to {host}",
                field="namer",
                hint="An admin of the project agrees once, on the page or by AgreeToNamer.",
            )
        job = order_job("ask_namer", scene_id, request_id, {}, self._project)
        return self._jobs.operation(place_order(job, self._store, self._quotas))
