"""Workers a device: which environment each has."""

from __future__ import annotations

import os

import pytest

from fastsplat.cli.operating.serve import worker_roles
from fastsplat_contract.errors import InvalidInputError

_CPUS = len(os.sched_getaffinity(0))


def test_each_device_has_a_worker_that_sees_no_other():
    roles = worker_roles("0,3,GPU-1a2b", 1, 0)
    assert {name: role.environment["CUDA_VISIBLE_DEVICES"] for name, role in roles.items()} == {
        "worker-0": "0",
        "worker-3": "3",
        "worker-GPU-1a2b": "GPU-1a2b",
    }


def test_workers_without_a_gpu_share_the_cpus():
    roles = worker_roles("cpu", 2, 0)
    assert list(roles) == ["worker-cpu-1", "worker-cpu-2"]
    for role in roles.values():
        assert role.environment == {
            "CUDA_VISIBLE_DEVICES": "",
            "FASTSPLAT_JOBS__THREADS_PER_JOB": str(max(1, _CPUS // 2)),
        }


def test_one_worker_needs_no_environment_and_a_setting_of_threads_stays():
    assert [role.environment for role in worker_roles("", 1, 0).values()] == [{}]
    assert [role.environment for role in worker_roles("", 3, 5).values()] == [{}] * 3


@pytest.mark.parametrize(("devices", "workers"), [("0,0", 1), ("tpu", 1), ("0;rm", 1), ("0,", 1), ("cpu", 0)])
def test_nonsense_is_refused(devices, workers):
    with pytest.raises(InvalidInputError) as caught:
        worker_roles(devices, workers, 0)
    assert caught.value.field in ("devices", "workers")
