"""The service as a key for one upload has it: files may come, one scene is made of them, and its job may be watched."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

from sqlalchemy import Connection

from fastsplat.service.store.key_repository import use_key
from fastsplat.service.store.scene_repository import no_operation
from fastsplat.service.store.store import Store
from fastsplat_contract.errors import ConflictError, PermissionDeniedError
from fastsplat_contract.operations import Operation, SceneOptions

if TYPE_CHECKING:
    from fastsplat.service.application.resumable import Resumable, ResumableUploads
    from fastsplat.service.application.service import SceneService
    from fastsplat.service.application.uploads import UploadSession

_DAY_S = 86_400.0
"""From the making of a key on, so long an upload that has begun with it, and its job, may be followed."""


def check_unused(connection: Connection, key_id: str, operation_id: str) -> None:
    """Note that a key makes an operation, in the transaction that makes it.

    Raises:
        ConflictError: it has made one before, or is not valid any more; the transaction must not be committed.
    """
    if not use_key(connection, key_id, operation_id, time.time()):
        raise _used()


class OneUpload:
    """What a key for one upload may do; anything else of the service is refused here, too.

    Args:
        service: of the key's project.
        store: of the same.
        key_id: the key's.
        max_files: of the one upload.
    """

    def __init__(self, service: SceneService, store: Store, key_id: str, max_files: int) -> None:
        self._max_files = max_files
        self._service = service
        self._keys = store.keys
        self._key_id = key_id

    def __getattr__(self, name: str) -> Any:
        raise PermissionDeniedError("a key for one upload does no more than that", field="authorization")

    def new_upload(self) -> UploadSession:
        """As `SceneService.new_upload`, while the key has made no scene; from then on it is valid for a day."""
        self.begin()
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
        return _OwnUploads(self, self._service.resumable.of_key(self._key_id, self._max_files))

    def get_operation(self, operation_id: str) -> Operation:
        """The operation that the key has made.

        Raises:
            NotFoundError: it has made none of that id.
        """
        record = self._keys.find(self._key_id)
        if record is None or record.operation_id != operation_id:
            raise no_operation(operation_id)
        return self._service.get_operation(operation_id)

    def status(self, *caller: Any) -> Any:
        """As `SceneService.status`."""
        return self._service.status(*caller)

    def begin(self) -> None:
        """Let the key be valid for a day, as an upload begins.

        Raises:
            ConflictError: it has made a scene before.
        """
        record = self._keys.find(self._key_id)
        if record is None or record.operation_id is not None:
            raise _used()
        self._keys.prolong(self._key_id, record.created_at + _DAY_S)


class _OwnUploads:
    """The resumable uploads of the key, of which each new one begins the upload that the key is for."""

    def __init__(self, upload: OneUpload, uploads: ResumableUploads) -> None:
        self._upload, self._uploads = upload, uploads

    def __getattr__(self, name: str) -> Any:
        return getattr(self._uploads, name)

    def create(self, project: str, name: str, length: int, metadata: str = "") -> Resumable:
        """As `ResumableUploads.create`.

        Raises:
            ConflictError: the key has made a scene before, too.
        """
        self._upload.begin()
        return self._uploads.create(project, name, length, metadata)


def _used() -> ConflictError:
    return ConflictError(
        "this key was for one upload, and has made its scene",
        field="authorization",
        hint="Make another link, or key, for another scene.",
    )
