"""Health of a server: who does its jobs, what waits, and how much room its disk has."""

from __future__ import annotations

import shutil
import time

from fastsplat.service.settings import Settings
from fastsplat.service.store.reserve import floor_of
from fastsplat.service.store.store import Store
from fastsplat_contract.server_status import DiskHealth, QueueHealth, ServerHealth, WorkerHealth


def server_health(store: Store, settings: Settings) -> ServerHealth:
    """The health of the workers and the queue of this database, and of this server's disk, now.

    Seconds are by this machine's clock: they are wrong by as much as a worker's differs.

    Raises:
        DatabaseError: the database does not answer.
        OSError: the data folder is gone.
    """
    now, timeout_s = time.time(), settings.jobs.stalled_worker_timeout_s
    registered = [worker for worker in store.workers.list_workers() if worker.heartbeat_at > 0]
    jobs, since = store.job_metrics.jobs_by_state(), store.job_metrics.waits_since()
    root = store.blobs.root
    disk = shutil.disk_usage(root)
    return ServerHealth(
        workers=tuple(
            WorkerHealth(
                host=worker.host,
                pid=worker.pid,
                silent_s=max(0.0, now - worker.heartbeat_at),
                alive=worker.heartbeat_at >= now - timeout_s,
            )
            for worker in sorted(registered, key=lambda worker: (worker.host, worker.pid))
        ),
        queue=QueueHealth(jobs["QUEUED"], jobs["RUNNING"], None if since is None else max(0.0, now - since)),
        disk=DiskHealth(disk.total, disk.free, floor_of(root, settings.uploads.min_free_bytes)),
    )
