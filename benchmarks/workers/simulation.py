"""Jobs a day by the number of workers that share a database: a discrete-event simulation.

Each worker takes the next job at its next look into the queue, runs it, and takes another; there is always one. All
that a worker asks of the database (looks, claims, heartbeats, progress) waits in one line before the database's cores,
first come, first served. Workers do not share processors, and files move at no cost.
"""

from __future__ import annotations

import heapq
import random
from collections.abc import Sequence
from dataclasses import dataclass

_DAY_S = 86_400.0
_CLEANING, _CLEANING_EVERY_S = -2.0, 60.0


@dataclass(frozen=True)
class Costs:
    """What was measured.

    Attributes:
        jobs_s: seconds of whole jobs, one of which each simulated job takes.
        turn_s: of a database's core, for all that a worker asks in one turn of `every_s` seconds.
        job_s: of a database's core, for what a job asks once: to be claimed, its stages, its end.
        every_s: seconds between two looks of a worker.
        cores: of the database.
        cleaning_s: of a database's core, for what one worker a minute asks to clean up for all.
    """

    jobs_s: Sequence[float]
    turn_s: float
    job_s: float
    every_s: float
    cores: int
    cleaning_s: float = 0.0


@dataclass(frozen=True)
class Outcome:
    """What was simulated.

    Attributes:
        jobs_a_day: that ended, per 86,400 seconds.
        of_workers_alone: as a share of what as many workers would do, each with a database of its own that takes no
            time.
        database: share of its cores' time that it was busy.
        longest_turn_s: the longest that all of a worker's turn took, its wait included. Workers whose heartbeat is late
            by more than FASTSPLAT_JOBS__STALLED_WORKER_TIMEOUT_S would lose their jobs.
    """

    jobs_a_day: float
    of_workers_alone: float
    database: float
    longest_turn_s: float


def simulate(workers: int, costs: Costs, *, hours: float = 24.0, seed: int = 0) -> Outcome:
    """Let workers work for some hours.

    Args:
        workers: how many, at least 1.
        costs: what everything takes.
        hours: simulated.
        seed: of the order of jobs, and of the moments at which workers start.
    """
    rng, end = random.Random(seed), hours * 3600.0
    free = [0.0] * costs.cores  # when each core of the database is
    done, busy, longest = 0, 0.0, 0.0
    # (moment, number of the event, seconds of the job that ends then; 0 for a turn, below for a first job or cleaning)
    events = [(rng.uniform(0, costs.every_s), number, 0.0) for number in range(workers)]
    events += [(rng.uniform(0, costs.every_s), workers + number, -1.0) for number in range(workers)]
    events.append((_CLEANING_EVERY_S, 2 * workers, _CLEANING))
    heapq.heapify(events)
    number = 2 * workers

    def served(at: float, seconds: float) -> float:
        nonlocal busy
        core = heapq.heappop(free)
        over = max(at, core) + seconds
        heapq.heappush(free, over)
        busy += seconds
        return over

    while events[0][0] < end:
        at, _, job_s = heapq.heappop(events)
        number += 1
        if job_s == 0.0:  # a turn, again and again
            over = served(at, costs.turn_s)
            longest = max(longest, over - at)
            heapq.heappush(events, (max(at + costs.every_s, over), number, 0.0))
            continue
        if job_s == _CLEANING:
            over = served(at, costs.cleaning_s)
            heapq.heappush(events, (max(at + _CLEANING_EVERY_S, over), number, _CLEANING))
            continue
        done += job_s > 0
        begun = served(at, costs.job_s)
        taken = rng.choice(costs.jobs_s)
        ends = begun + taken
        look = ends + rng.uniform(0, costs.every_s)  # the engine looks at moments of its own
        heapq.heappush(events, (look, number, taken))
    alone = workers * _DAY_S / (sum(costs.jobs_s) / len(costs.jobs_s) + costs.every_s / 2)
    per_day = done * 24.0 / hours
    return Outcome(per_day, per_day / alone, min(1.0, busy / (costs.cores * end)), longest)
