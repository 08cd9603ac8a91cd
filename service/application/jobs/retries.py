"""Retries of failed and cancelled jobs, optionally without some photos."""

from __future__ import annotations

import time
from collections.abc import Sequence

from fastsplat.service.application.answering.project_context import ProjectContext
from fastsplat.service.capture.formats.upload_manifest import read_manifest
from fastsplat.service.capture.uploads.photo_exclusion import photo_paths, without_photos
from fastsplat.service.store.repositories.scene_repository import no_upload
from fastsplat.service.store.rows.records import OperationRecord
from fastsplat.service.store.store import Store
from fastsplat_contract.errors import InvalidInputError, NotReadyError
from fastsplat_contract.jobs.operations import FINAL_STATES


def retry(operation_id: str, exclude: Sequence[str], context: ProjectContext) -> OperationRecord:
    """Queues a failed or cancelled job again; other jobs are returned unchanged.

    `exclude` are photos to leave out, in addition to those of earlier retries.

    Raises:
        NotFoundError: no such job, or its scene or upload was deleted.
        InvalidInputError: an unknown photo, or too few remain.
        NotReadyError: new exclusions for a job that neither failed nor was cancelled.
        QuotaError: too many active jobs in the project.
    """
    store = context.store
    record = store.scenes.operation(operation_id)
    if record.state in ("FAILED", "CANCELLED"):
        if record.makes_scene and record.upload_id not in store.blobs.ids("uploads"):
            raise no_upload(operation_id)
        context.quotas.check_retry(context.project)
    paths = _checked(record, exclude, store) if exclude else ()
    if not set(paths) <= set(record.excluded) and record.state not in ("FAILED", "CANCELLED"):
        raise NotReadyError(
            f"operation {operation_id!r} is {record.state}",
            field="exclude",
            hint="Its scene is made with all its photos; delete it, and post the others as a new one."
            if record.state in FINAL_STATES
            else "Cancel it first, then retry it without them.",
        )
    return store.jobs.retry(operation_id, time.time() - context.settings.uploads.failed_retention_s, paths)


def _checked(record: OperationRecord, exclude: Sequence[str], store: Store) -> tuple[str, ...]:
    """Paths of the photos to exclude from a job's upload."""
    if not record.makes_scene:
        raise InvalidInputError(
            f"a job of the kind {record.kind} reads no upload that photos could be left out of",
            field="exclude",
            hint="Retry it without.",
        )
    if record.upload_id not in store.blobs.ids("uploads"):
        raise no_upload(record.id)
    manifest, _ = read_manifest(store.blobs.fetch_upload(record.upload_id) / record.options["validated"])
    paths = photo_paths(manifest, exclude)
    without_photos(manifest, {*record.excluded, *paths})
    return paths
