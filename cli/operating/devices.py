"""One worker process a device, and the environment of each."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Mapping

from fastsplat.cli.operating.serve import Role
from fastsplat_contract.errors import InvalidInputError

_CPU = "cpu"


def worker_roles(devices: str, workers: int, threads_per_job: int) -> Mapping[str, Role]:
    """The workers of this machine, by name.

    Args:
        devices: comma-separated CUDA device numbers or ids, each for workers of its own, or "cpu"; "" leaves the choice
            to CUDA_VISIBLE_DEVICES as it is.
        workers: worker processes a device.
        threads_per_job: the setting; for 0, all workers share the machine's CPUs evenly.

    Raises:
        InvalidInputError: an unknown kind of device, one named twice, or no worker.
    """
    from fastsplat.service.common.setting_groups import environment_variable
    from fastsplat.service.settings import JobSettings

    names = [name.strip() for name in devices.split(",")] if devices else [""]
    invalid = [name for name in names if devices and not re.fullmatch(rf"{_CPU}|\d+|(GPU|MIG)-[\w/-]+", name)]
    if invalid:
        raise InvalidInputError(
            f"{invalid[0][:40]!r} is no device", field="devices", hint='Write e.g. "0,1", "GPU-<id>", or "cpu".'
        )
    if len(set(names)) < len(names):
        raise InvalidInputError("a device is named twice", field="devices", hint="Use --workers for several on one.")
    if workers < 1:
        raise InvalidInputError(f"{workers} workers", field="workers", limit="at least 1")
    count = len(names) * workers
    roles = {}
    for name in names:
        for number in range(1, workers + 1):
            environment = {} if not devices else {"CUDA_VISIBLE_DEVICES": "" if name == _CPU else name}
            if count > 1 and not threads_per_job:
                threads = max(1, len(os.sched_getaffinity(0)) // count)
                environment[environment_variable(JobSettings, "threads_per_job")] = str(threads)
            parts = ["worker", name, str(number) if workers > 1 else ""]
            command = [sys.executable, "-m", "fastsplat.cli.main", "worker"]
            roles["-".join(part for part in parts if part)] = Role(command, environment)
    return roles
