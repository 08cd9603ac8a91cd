"""Garbage collection: crash leftovers, expired uploads, old logs and rows.

All functions raise `ConflictError`, having changed nothing, if the database does not belong to the store's files.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Iterable

from fastsplat.service.store.rows.identity import check_identity
from fastsplat.service.store.store import Store
from fastsplat.workers.engine.periodic import RepeatFilter

TRASH_S = 7 * 24 * 3600.0  # retention of lost scenes in the trash
_MOST_AT_ONCE = 3
"""More lost scenes or versions indicate a database problem rather than leftovers."""
_PUBLISHED_BEFORE_S = 24 * 3600.0  # later versions may still get their row
_DELETION_S = 3600.0  # scenes that lost their row later are still being deleted

logger = logging.getLogger(__name__)
logger.addFilter(RepeatFilter(interval_s=3600.0, length=200))


def remove_unneeded(
    store: Store,
    upload_expiry_s: float,  # of unneeded uploads, since their last change
    ended_job_retention_s: float,  # of logs, and of operations without a scene
    failed_upload_retention_s: float,  # of uploads of failed and cancelled jobs
) -> None:
    """Deletes work folders of ended jobs, used and expired uploads, old logs and rows."""
    check_identity(store.engine, store.blobs)
    # Folders are listed before rows are read, so that newer ones have their row and stay.
    blobs = store.blobs
    jobs, uploads = blobs.ids("jobs"), blobs.ids("uploads")
    for run_id in store.jobs.over(jobs):
        blobs.drop_job(run_id)
    used, unknown = store.jobs.unneeded_uploads(uploads, time.time() - failed_upload_retention_s)
    for upload_id in used.union(name for name in unknown if blobs.upload_age(name) > upload_expiry_s):
        blobs.drop_upload(upload_id)
    if store.engine.dialect.name == "sqlite":
        store.reserve.fill()
    blobs.remove_old_logs(ended_job_retention_s)
    store.jobs.delete_ended(time.time() - ended_job_retention_s)


def trash_lost_scenes(store: Store, now: float) -> None:
    """Trashes scenes that lost their row, and deletes those trashed `TRASH_S` ago.

    Only scenes with known jobs; those unknown to the database stay, e.g. after restoring an older database. `now` is
    seconds since 1970, robust against clock jumps (`ActivityClock`).
    """
    check_identity(store.engine, store.blobs)
    lost, unknown = store.jobs.lost_scenes(store.blobs.ids("scenes"), now - _DELETION_S)
    if unknown:
        logger.warning("the database knows nothing of these scenes, which stay: %s", _listed(unknown))
    if len(lost) > _MOST_AT_ONCE:
        logger.warning("the rows of %d scenes are gone, and the scenes stay: %s", len(lost), _listed(lost))
        lost = frozenset()
    for scene_id in sorted(lost):
        logger.warning("the row of scene %s is gone; the scene goes to the trash for seven days", scene_id)
        store.blobs.trash_scene(scene_id, now)
    for name in store.blobs.trashed_scenes():
        scene_id, _, moved_at = name.rpartition(".")
        if moved_at.isdecimal() and now - int(moved_at) > TRASH_S:
            logger.warning("scene %s was in the trash for seven days and is erased", scene_id)
            store.blobs.drop_trashed(name)


def trash_lost_versions(store: Store, now: float) -> None:
    """Trashes day-old versions without a row, left by failures between folder and row."""
    check_identity(store.engine, store.blobs)
    # Folders are listed before rows are read, and jobs before versions, so that newer ones have their row and stay.
    old = {key for key, published_at in store.blobs.versions().items() if now - published_at > _PUBLISHED_BEFORE_S}
    runs_over = store.jobs.over([version for _, version in old])
    lost = sorted(store.versions.without_row([key for key in old if key[1] in runs_over]))
    names = _listed("/".join(key) for key in lost)
    if len(lost) > _MOST_AT_ONCE:
        logger.warning("%d versions of scenes have no row, and stay: %s", len(lost), names)
        return
    for scene_id, version in lost:
        logger.warning("version %s of scene %s has no row; it goes to the trash", version, scene_id)
        store.blobs.trash_version(scene_id, version, now)


def _listed(names: Iterable[str]) -> str:
    return ", ".join(sorted(names))
