"""Versions that no row names: a process ended, or a database went away, between their folder and their row."""

from __future__ import annotations

import logging

from fastsplat.service.store import Store

_PUBLISHED_BEFORE_S = 24 * 3600.0
"""What was published later may get its row yet."""
_MOST_AT_ONCE = 3
"""More at a time are no remains of crashes: an older database was put back."""

logger = logging.getLogger(__name__)


def trash_lost_versions(store: Store, now: float) -> None:
    """Move versions without a row to the trash, those of scenes that have one, if they are a day old.

    Args:
        store: what to clean.
        now: seconds since 1970.
    """
    # Folders are listed before rows are read, and jobs before versions: what ended since then has its row and stays.
    old = {key for key, published_at in store.blobs.versions().items() if now - published_at > _PUBLISHED_BEFORE_S}
    runs_over = store.jobs.over([version for _, version in old])
    lost = sorted(store.versions.without_row([key for key in old if key[1] in runs_over]))
    names = ", ".join("/".join(key) for key in lost)
    if len(lost) > _MOST_AT_ONCE:
        logger.warning("%d versions of scenes have no row, and stay: %s", len(lost), names)
        return
    for scene_id, version in lost:
        logger.warning("version %s of scene %s has no row; it goes to the trash", version, scene_id)
        store.blobs.trash_version(scene_id, version, now)
