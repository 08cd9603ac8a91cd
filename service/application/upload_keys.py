"""Service facade for an upload key: one upload, one scene, and watching its job."""

from __future__ import annotations

from typing import Any

from fastsplat.service.application.jobs.estimates import JobEstimates
from fastsplat.service.application.service import SceneService
from fastsplat.service.application.uploading.resumable import ResumableUploads
from fastsplat.service.application.uploading.uploads import UploadSession
from fastsplat_contract.errors import PermissionDeniedError
from fastsplat_contract.jobs.operations import Operation, SceneOptions


class OneUpload:
    """The calls permitted to an upload key; all others are refused."""

    def __init__(self, service: SceneService, key_id: str) -> None:
        self._service = service
        self._key_id = key_id

    def __getattr__(self, name: str) -> Any:
        raise PermissionDeniedError("a key for one upload does no more than that", field="authorization")

    def new_upload(self) -> UploadSession:
        """As `SceneService.new_upload`, extending an unused key to a day; raises `ConflictError` for a used one."""
        self._service.keys.begin_upload(self._key_id)
        return self._service.new_upload()

    def create_scene(self, upload: UploadSession, name: str, request_id: str, options: SceneOptions) -> Operation:
        """As `SceneService.create_scene`; raises `ConflictError` if the key was used before."""
        return self._service.create_scene(upload, name, request_id, options, upload_key=self._key_id)

    @property
    def resumable(self) -> ResumableUploads:
        """As `SceneService.resumable`, restricted to the key's own; `create` raises as `new_upload`."""
        service = self._service
        return service.resumable.of_key(self._key_id, service.max_entries, service.keys.begin_upload)

    def get_operation(self, operation_id: str) -> Operation:
        """The key's own operation; raises `NotFoundError` for any other."""
        self._service.keys.check_made(self._key_id, operation_id)
        return self._service.get_operation(operation_id)

    @property
    def estimates(self) -> JobEstimates:
        return self._service.estimates

    def status(self, *caller: Any) -> Any:
        return self._service.status(*caller)
