"""The packaged sample scene, copied into a project."""

from __future__ import annotations

import time
import uuid
from contextlib import closing
from dataclasses import replace

from fastsplat.service.application.answering.project_context import ProjectContext
from fastsplat.service.application.uploading.uploads import disk_error
from fastsplat.service.store.blobs.blobs import remove
from fastsplat.service.store.care.sample_scene import unpack_sample
from fastsplat.service.store.store import open_store

_NAME = "A table (sample)"
_REQUEST = "fastsplat.sample"
"""Request id and digest of the copy: a project has one at a time."""


def copy_sample(context: ProjectContext) -> str:
    """Copies the sample scene into a project unless present; durable on return.

    Returns:
        The id of the sample scene, which may have been renamed or edited since.

    Raises:
        QuotaError: the project is full.
        ResourceError: the disk is full, or the sample is not installed.
        InvalidInputError: the installed sample is damaged.
        ConflictError: the sample's request id is used by another scene.
    """
    store = context.store
    earlier = store.scenes.find_request(_REQUEST, _REQUEST, context.project)
    if earlier is not None:
        return earlier.scene_id
    context.quotas.check_room(context.project, 0)
    scene_id = uuid.uuid4().hex
    scratch = store.blobs.upload(scene_id)  # on the scenes' disk; after a crash removed as an upload
    try:
        unpack_sample(scratch)
        return _add(context, scene_id)
    finally:
        remove(scratch)


def _add(context: ProjectContext, scene_id: str) -> str:
    """Adds the sample unpacked into the upload of this id."""
    now, store, project = time.time(), context.store, context.project
    with closing(open_store(store.blobs.upload(scene_id))) as unpacked:
        (sample_id,) = unpacked.scenes.ready_scene_ids()
        sample = unpacked.scenes.scene(sample_id)
        job = unpacked.scenes.operation(sample.operation_id)
        photos = unpacked.scenes.photos_of(sample_id)
        folder = unpacked.blobs.version(sample_id, sample.version)
        size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    made_by = uuid.uuid4().hex
    scene = replace(sample, id=scene_id, name=_NAME, operation_id=made_by, project=project, created_at=now)
    operation = replace(
        job, id=made_by, scene_id=scene_id, project=project, created_at=now, updated_at=now,
        request_digest=_REQUEST, progress_files=None,
    )  # fmt: skip
    try:
        store.blobs.publish(folder, scene_id, scene.version)
    except OSError as error:
        raise disk_error(error, "sample") from error
    try:
        record = store.scenes.add_ready(
            scene,
            operation,
            _REQUEST,
            photos,
            lambda database: context.quotas.reserve(database, project, scene_id, size),
        )
    except BaseException:
        store.blobs.drop_scene(scene_id)
        raise
    if record.scene_id != scene_id:  # another caller was faster
        store.blobs.drop_scene(scene_id)
    return record.scene_id
