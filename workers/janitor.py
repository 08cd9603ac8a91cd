"""Removes what crashes left behind: folders that no row needs any more."""

from __future__ import annotations

import time
from contextlib import suppress

from fastsplat.service.store import Store
from fastsplat.service.store.blobs import Blobs, remove


def clean(store: Store, abandoned_upload_s: float, keep_ended_s: float) -> None:
    """Remove work folders of ended jobs, deleted scenes, used uploads, abandoned ones, and what is left of old jobs.

    Folders are listed before rows are read: what came since then has its row and stays.
    """
    blobs = store.blobs
    jobs, uploads, scenes = blobs.ids("jobs"), blobs.ids("uploads"), blobs.ids("scenes")
    for operation_id in store.jobs.over(jobs):
        remove(blobs.job(operation_id))
    for scene_id in store.jobs.unknown_scenes(scenes):
        blobs.drop_scene(scene_id)
    live, used = store.jobs.uploads()
    for upload_id in uploads:
        if upload_id in used or (upload_id not in live and blobs.upload_age(upload_id) > abandoned_upload_s):
            blobs.drop_upload(upload_id)
    _remove_old_logs(blobs, keep_ended_s)
    store.jobs.forget_ended(time.time() - keep_ended_s)


def _remove_old_logs(blobs: Blobs, keep_ended_s: float) -> None:
    for path in (blobs.root / "logs").glob("*.log"):
        with suppress(FileNotFoundError):  # another worker's janitor was faster
            if time.time() - path.stat().st_mtime > keep_ended_s:
                path.unlink()
