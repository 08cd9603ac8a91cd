"""Removes what is not needed any more: what crashes left behind, expired uploads, old logs and rows."""

from __future__ import annotations

import time
from contextlib import suppress

from fastsplat.service.store import Store
from fastsplat.service.store.blobs import Blobs


def remove_unneeded(
    store: Store, upload_expiry_s: float, ended_job_retention_s: float, failed_upload_retention_s: float
) -> None:
    """Remove work folders of ended jobs, deleted scenes, used and expired uploads, and logs and rows of old jobs.

    Args:
        store: what to clean.
        upload_expiry_s: uploads that no job needs are removed when nothing of them has changed for so long.
        ended_job_retention_s: logs, and operations without a scene, are removed so long after their end.
        failed_upload_retention_s: uploads of failed and cancelled jobs are removed so long after their end.
    """
    # Folders are listed before rows are read: what came since then has its row and stays.
    blobs = store.blobs
    jobs, uploads, scenes = blobs.ids("jobs"), blobs.ids("uploads"), blobs.ids("scenes")
    for run_id in store.jobs.over(jobs):
        blobs.drop_job(run_id)
    for scene_id in store.jobs.unknown_scenes(scenes):
        blobs.drop_scene(scene_id)
    needed, used = store.jobs.uploads(time.time() - failed_upload_retention_s)
    for upload_id in uploads:
        if upload_id in used or (upload_id not in needed and blobs.upload_age(upload_id) > upload_expiry_s):
            blobs.drop_upload(upload_id)
    if store.engine.dialect.name == "sqlite":
        store.reserve.fill()
    _remove_old_logs(blobs, ended_job_retention_s)
    store.jobs.delete_ended(time.time() - ended_job_retention_s)


def _remove_old_logs(blobs: Blobs, retention_s: float) -> None:
    for path in (blobs.root / "logs").glob("*.log"):
        with suppress(FileNotFoundError):  # another worker removed it first
            if time.time() - path.stat().st_mtime > retention_s:
                path.unlink()
