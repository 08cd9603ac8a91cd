"""Jobs on a Ray cluster: for each a detached actor, which is a worker of this job alone on the node that has room.

The actor claims the job when Ray has reserved what it needs, so that none is taken without room, and supervises it on
its node: neither this process's death nor its restart matters to it. Ray says where a job runs and nothing else: order,
fencing and recovery are the rows' and the heartbeats', as an actor may live on for seconds after its node was lost.
"""

from __future__ import annotations

import logging
import os
import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import ray

from fastsplat.service.planning.presets import chosen_settings
from fastsplat.service.settings import Settings, load_settings
from fastsplat.service.store.queue.claims import LONGEST_PAUSE_S
from fastsplat.service.store.rows.codec import options_from_json
from fastsplat.service.store.rows.records import OperationRecord
from fastsplat.workers.engine.worker import Worker, open_worker, run_next, start, stop
from fastsplat.workers.kinds.job_kinds import JobKind
from fastsplat_contract.jobs.operations import OperationKind

_NAMESPACE = "fastsplat"
_AT_ONCE = 4
"""Actors of one size that may wait for room: each holds the place in turn that its job had."""
_LOOKED_AT = 1_000  # waiting jobs of each project, the first in turn
_AGAIN_S = 30.0
"""After this an attempt is placed again, as its actor died, or its node lacks a model."""
_CPUS = 2  # where the operator did not say how many threads a job has
_MEMORY, _MEMORY_A_GAUSSIAN = 3 << 30, 16 << 10
"""Bytes: a job with its networks and pictures, and the optimization of a Gaussian."""


@dataclass(frozen=True)
class _Placement:
    """An actor of a size, requested at a time, in monotonic seconds; `has_room` is ready once it runs or has died."""

    size: frozenset[tuple[str, float]]
    has_room: ray.ObjectRef[None]
    at: float


class RayCluster:
    """A launcher that has each waiting job run by an actor, as many at once as the cluster has room for.

    The cluster is that of Ray's own variable `RAY_ADDRESS`, else the one that this machine has joined.
    """

    def __init__(self) -> None:
        self._agents: Any = ray.remote(_Agent)  # whose methods Ray adds
        self._placed: dict[str, _Placement] = {}

    def __call__(self, worker: Worker) -> None:
        if not ray.is_initialized():
            ray.init("auto", namespace=_NAMESPACE, log_to_driver=False, configure_logging=False)
        now = time.monotonic()
        waiting = {
            name: placed for name, placed in self._placed.items() if not ray.wait([placed.has_room], timeout=0)[0]
        }
        recent = {name: placed for name, placed in self._placed.items() if now - placed.at < _AGAIN_S}
        self._placed = waiting | recent
        counts = Counter(placed.size for placed in waiting.values())
        for job in worker.store.jobs.in_turn(_LOOKED_AT):
            name, needs = f"{job.id}-{job.attempt + 1}", needs_of(job, worker.settings)
            size, put_off = frozenset(needs.items()), 0 < job.run_after - time.time() < 2 * LONGEST_PAUSE_S
            if name not in self._placed and not put_off and counts[size] < _AT_ONCE:
                counts[size] += 1
                options: Mapping[str, Any] = {**needs, "name": name, "lifetime": "detached", "get_if_exists": True}
                actor = self._agents.options(**options).remote(job.id, worker.kinds)
                self._placed[name] = _Placement(size, actor.has_room.remote(), now)


def needs_of(job: OperationRecord, settings: Settings) -> dict[str, float]:
    """What Ray reserves for a job: more memory than a machine must have for it, for as many as it has room for."""
    training = chosen_settings(settings, options_from_json({**job.options, "priority": job.priority})).training
    gaussians = training.max_gaussians if job.makes_scene else 0
    return {
        "num_cpus": settings.jobs.threads_per_job or _CPUS,
        "num_gpus": job.gpus,
        "memory": _MEMORY + gaussians * _MEMORY_A_GAUSSIAN,
    }


class _Agent:
    """The actor: a worker of one job by the settings of its node, whose process ends with the job."""

    def __init__(self, job_id: str, kinds: Mapping[OperationKind, JobKind]) -> None:
        os.umask(0o077)
        logging.basicConfig(level=logging.INFO)
        self._job_id = job_id
        start(open_worker(load_settings(), kinds), self._run)

    def has_room(self) -> None:
        """Returns once the actor runs."""

    def _run(self, worker: Worker) -> None:
        try:
            run_next(worker, self._job_id)
            stop(worker)
        finally:
            logging.shutdown()
            os._exit(0)  # which frees what was reserved
