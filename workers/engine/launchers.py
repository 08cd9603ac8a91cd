"""Which launcher the settings name."""

from __future__ import annotations

from fastsplat.service.common.optional_packages import RAY, needed
from fastsplat.service.settings import JobSettings
from fastsplat.workers.engine.worker import Launcher, run_here


def open_launcher(settings: JobSettings) -> Launcher:
    """Returns where jobs run; raises `MissingPackageError` for Ray where it is not installed."""
    if settings.launcher == "local":
        return run_here
    with needed(RAY, "the launcher ray", field="jobs.launcher", where="on every machine of the cluster"):
        from fastsplat.workers.engine.ray_cluster import RayCluster
    return RayCluster(settings.ray_address)
