"""Removes what crashes left behind: folders that no row needs any more."""

from __future__ import annotations

import time
from pathlib import Path

from service.store import Store
from service.store.blobs import remove


def clean(store: Store, abandoned_upload_s: float) -> None:
    """Remove work folders of ended jobs, deleted scenes, used uploads, and uploads abandoned for so long.

    Folders are listed before rows are read: what came since then has its row and stays.
    """
    blobs = store.blobs
    jobs, uploads, scenes = blobs.ids("jobs"), blobs.ids("uploads"), blobs.ids("scenes")
    for operation_id in store.jobs.over(jobs):
        remove(blobs.job(operation_id))
    for scene_id in store.jobs.unknown_scenes(scenes):
        remove(blobs.scene(scene_id))
    live, used = store.jobs.uploads()
    for upload_id in uploads:
        folder = blobs.upload(upload_id)
        if upload_id in used or (upload_id not in live and _age(folder) > abandoned_upload_s):
            remove(folder)


def _age(folder: Path) -> float:
    try:
        return time.time() - max(path.stat().st_mtime for path in (folder, *folder.rglob("*")))
    except OSError:  # somebody is changing it right now
        return 0.0
