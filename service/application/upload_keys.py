"""The service for a key of one upload: files may come, one scene is made of them, and its job may be watched."""

from __future__ import annotations

from typing import Any

from fastsplat.service.application.jobs.estimates import JobEstimates
from fastsplat.service.application.service import SceneService
from fastsplat.service.application.uploading.resumable import Resumable, ResumableUploads
from fastsplat.service.application.uploading.uploads import UploadSession
from fastsplat_contract.errors import PermissionDeniedError
from fastsplat_contract.jobs.operations import Operation, SceneOptions


class OneUpload:
    """The calls that a key for one upload may make; anything else of the service is refused here, too."""

    def __init__(self, service: SceneService, key_id: str) -> None:
        self._service = service
        self._key_id = key_id

    def __getattr__(self, name: str) -> Any:
        raise PermissionDeniedError("a key for one upload does no more than that", field="authorization")

    def new_upload(self) -> UploadSession:
        """As `SceneService.new_upload`, while the key has made no scene; from then on it is valid for a day."""
        self._service.keys.begin_upload(self._key_id)
        return self._service.new_upload()

    def create_scene(self, upload: UploadSession, name: str, request_id: str, options: SceneOptions) -> Operation:
        """As `SceneService.create_scene`; the key makes no second one.

        Raises:
            ConflictError: it has made one before.
        """
        return self._service.create_scene(upload, name, request_id, options, upload_key=self._key_id)

    @property
    def resumable(self) -> _OwnUploads:
        """As `SceneService.resumable`, of which there are none but the key's own."""
        own = self._service.resumable.of_key(self._key_id, self._service.max_entries)
        return _OwnUploads(self._service, self._key_id, own)

    def get_operation(self, operation_id: str) -> Operation:
        """The operation that the key has made. Raises `NotFoundError`: it has made none of that id."""
        self._service.keys.check_made(self._key_id, operation_id)
        return self._service.get_operation(operation_id)

    @property
    def estimates(self) -> JobEstimates:
        """As `SceneService.estimates`."""
        return self._service.estimates

    def status(self, *caller: Any) -> Any:
        """As `SceneService.status`."""
        return self._service.status(*caller)


class _OwnUploads:
    """The resumable uploads of the key, of which each new one begins the upload that the key is for."""

    def __init__(self, service: SceneService, key_id: str, uploads: ResumableUploads) -> None:
        self._service, self._key_id, self._uploads = service, key_id, uploads

    def __getattr__(self, name: str) -> Any:
        return getattr(self._uploads, name)

    def create(self, project: str, name: str, length: int, metadata: str = "") -> Resumable:
        """As `ResumableUploads.create`. Raises `ConflictError`: the key has made a scene before, too."""
        self._service.keys.begin_upload(self._key_id)
        return self._uploads.create(project, name, length, metadata)
