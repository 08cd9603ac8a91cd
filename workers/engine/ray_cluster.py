"""Jobs on a Ray cluster: for each a detached actor, which is a worker of this job alone on the node that has room.

The actor claims the job when Ray has reserved what it needs, so that none is taken without room, and supervises it on
its node: neither the launcher's death nor its restart matters to it. Ray says where a job runs and nothing else: order,
fencing and recovery are the rows' and the heartbeats', as an actor may live on for seconds after its node was lost.
"""

from __future__ import annotations

import logging
import os
import signal
import time
from collections import Counter
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from multiprocessing import get_context
from typing import Any, NamedTuple

import ray
from ray.exceptions import RayError

from fastsplat.service.common.process import die_with_parent
from fastsplat.service.planning.presets import chosen_settings
from fastsplat.service.settings import Settings, load_settings
from fastsplat.service.store.queue.claims import LONGEST_PAUSE_S
from fastsplat.service.store.rows.codec import options_from_json
from fastsplat.service.store.rows.records import OperationRecord
from fastsplat.workers.engine.periodic import RepeatFilter
from fastsplat.workers.engine.worker import Worker, open_worker, run_next, start, stop
from fastsplat.workers.kinds.job_kinds import JobKind
from fastsplat_contract.jobs.operations import OperationKind

logger = logging.getLogger(__name__)
logger.addFilter(RepeatFilter(interval_s=60.0, length=40))

_PATIENCE_S = 60
"""Ray itself waits for a head that is not there for many minutes, without a word."""
_AT_ONCE = 4
"""Actors of one size that may wait for room: each holds the place in turn that its job had."""
_LOOKED_AT = 1_000  # waiting jobs of each project, the first in turn
_AGAIN_S = 30.0
"""After this an attempt is placed again, as its actor died, or its node lacks a model."""
_CPUS = 2  # where the operator did not say how many threads a job has
_MEMORY, _MEMORY_A_GAUSSIAN = 3 << 30, 16 << 10
"""Bytes: a job with its networks and pictures, and the optimization of a Gaussian."""


class _Placement(NamedTuple):
    """An actor of a size, requested at a time, in monotonic seconds; `has_room` is ready once it runs or has died."""

    size: frozenset[tuple[str, float]]
    has_room: ray.ObjectRef[None]
    at: float


_placed: dict[str, _Placement] = {}  # by the driver, for each name


class RayCluster:
    """A launcher that has each waiting job run by an actor, as many at once as the cluster has room for.

    The cluster is that of Ray's own variable `RAY_ADDRESS`, else the one that this machine has joined. Ray ends a
    process whose head is lost, so a child process is its driver: while the cluster is away, each call starts a new one.
    """

    def __init__(self) -> None:
        self._driver = _new_driver()

    def __call__(self, worker: Worker) -> None:
        now, waiting = time.time(), worker.store.jobs.in_turn(_LOOKED_AT)
        due = [job for job in waiting if not 0 < job.run_after - now < 2 * LONGEST_PAUSE_S]
        jobs = {f"{job.id}-{job.attempt + 1}": (job.id, needs_of(job, worker.settings)) for job in due}
        try:
            self._driver.submit(_place, jobs, worker.kinds).result()
        except (OSError, RuntimeError, RayError) as error:
            logger.warning("the Ray cluster is away, no job begins until it is back: %s", error)
            self._driver.shutdown(wait=False)
            self._driver = _new_driver()


def _new_driver() -> ProcessPoolExecutor:
    return ProcessPoolExecutor(1, get_context("spawn"), die_with_parent, (os.getpid(),))


@cache
def _agents() -> Any:
    """Connects this process with the cluster; returns `_Agent` with the methods that Ray adds."""
    ray.init("auto", namespace="fastsplat", log_to_driver=False, configure_logging=False)
    return ray.remote(_Agent)


def _place(jobs: Mapping[str, tuple[str, Mapping[str, float]]], kinds: Mapping[OperationKind, JobKind]) -> None:
    """Requests actors for jobs, in turn, by their names (id and needs of each); dies where Ray does not answer."""
    signal.alarm(_PATIENCE_S)
    agents, now = _agents(), time.monotonic()
    ready = {name for name, placed in _placed.items() if ray.wait([placed.has_room], timeout=0)[0]}
    for name in [name for name in ready if now - _placed[name].at >= _AGAIN_S]:
        del _placed[name]
    counts = Counter(placed.size for name, placed in _placed.items() if name not in ready)
    for name, (job_id, needs) in jobs.items():
        size = frozenset(needs.items())
        if name not in _placed and counts[size] < _AT_ONCE:
            counts[size] += 1
            actor = agents.options(**needs, name=name, lifetime="detached", get_if_exists=True).remote(job_id, kinds)
            _placed[name] = _Placement(size, actor.has_room.remote(), now)
    signal.alarm(0)


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
