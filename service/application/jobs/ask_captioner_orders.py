"""Requests to ask the server's captioner about a scene, run by a worker."""

from __future__ import annotations

from dataclasses import replace

from fastsplat.service.application.admin.server_capabilities import captioner_status
from fastsplat.service.application.answering.project_context import ProjectContext
from fastsplat.service.application.base.validate import check_request_id
from fastsplat.service.application.jobs.running_jobs import RunningJobs
from fastsplat.service.common.setting_groups import environment_variable
from fastsplat.service.settings import CaptionerSettings
from fastsplat.service.store.queue.ordered_jobs import order_job
from fastsplat_contract.errors import InvalidInputError, ModelUnavailableError, PermissionDeniedError
from fastsplat_contract.jobs.name_suggestions import CaptionerStatus
from fastsplat_contract.jobs.operations import Operation


class OwnCaptioner:
    """The server's captioner for one project. Thread-safe."""

    def __init__(self, context: ProjectContext, jobs: RunningJobs) -> None:
        self._context, self._jobs = context, jobs

    def agree(self, host: str) -> CaptionerStatus:
        """Records the project's consent to the captioner's host; "" withdraws it.

        Raises:
            ModelUnavailableError: the server has no captioner.
            InvalidInputError: the captioner has another host.
        """
        status = self._status()
        if host and host != status.host:
            raise InvalidInputError(
                f"the server's captioner is not at {host[:200]!r}", field="host", limit=f"{status.host}, or empty"
            )
        self._context.store.projects.agree(self._context.project, host)
        return replace(status, agreed=bool(host))

    def order(self, scene_id: str, request_id: str = "") -> Operation:
        """Queues a job that asks the captioner about all unnamed objects; durable on return.

        Usable suggestions become one version. The same `request_id` returns the same operation; "" for none.

        Raises:
            NotFoundError, NotReadyError: no such scene, or it is not ready.
            ModelUnavailableError: the server has no captioner.
            PermissionDeniedError: the project did not agree to the host.
            ConflictError, QuotaError: as `RunningJobs.order`.
        """
        check_request_id(request_id)
        self._context.scenes.finished(scene_id)
        status = self._status()
        if not status.agreed:
            raise PermissionDeniedError(
                f"the project did not agree that pictures of its objects go to {status.host}",
                field="captioner",
                hint="An admin of the project agrees once, on the page or by AgreeToCaptioner.",
            )
        job = order_job("ask_captioner", scene_id, request_id, {}, self._context.project)
        return self._jobs.order(job)

    def _status(self) -> CaptionerStatus:
        status = captioner_status(self._context.store, self._context.settings, self._context.project)
        if status is None:
            raise ModelUnavailableError(
                "this server has no captioner",
                field="captioner",
                hint=f"Set {environment_variable(CaptionerSettings, 'url')}.",
            )
        return status
