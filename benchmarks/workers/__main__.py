"""How jobs a day grow with workers: `python -m benchmarks.workers`, writes benchmarks/results/workers.json.

Measured: seconds of a PostgreSQL server's processors that real workers with their default intervals take, while they
wait, while each trains (a stage that sleeps), and for a job as such (stages that do nothing); and what calls take with
many scenes stored, see `stored`. Seconds and bytes of whole jobs are those of benchmarks/results/default_path.json, on
two cores each. From these, up to 100 workers are simulated, see `simulation`, and days of up to 1,000 nodes beside a
million scenes, see `day`. What more workers than were measured cost the database beside their own turns is not known.
"""

from __future__ import annotations

import json
import statistics
import tempfile
import time
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from benchmarks.provenance import NOT_CHOSEN, RESULTS, ROOT, begin, parser_of, write_results
from benchmarks.workers.database_seconds import cpu_seconds
from benchmarks.workers.day import Stored, Supposed, day
from benchmarks.workers.simulation import Costs, simulate
from benchmarks.workers.stored import stored_seconds
from fastsplat.service.common.setting_groups import settings_of
from fastsplat.service.library.sample import sample_folder
from fastsplat.service.settings import JobSettings
from fastsplat_contract.jobs.operations import Operation
from tests.postgres import PostgresServer
from tests.workers.deployment import Deployment

_WORKERS = (1, 2, 5, 10, 20, 50, 100)
_DATABASE_CORES = 2
_NODES = (1, 10, 100, 1_000)


def main() -> None:
    """Measure, simulate, write."""
    parser = parser_of(__doc__)
    parser.add_argument("--workers", type=int, default=3, help="real ones")
    parser.add_argument("--seconds", type=float, default=60.0, help="of each measurement")
    parser.add_argument("--jobs", type=int, default=20, help="that do nothing")
    parser.add_argument("--stored", type=int, default=1_000_000, help="scenes that are stored")
    options = parser.parse_args()
    start = begin()
    waiting, running, job_s = measure(options.workers, options.seconds, options.jobs)
    rows = json.loads((ROOT / "benchmarks/results/default_path.json").read_text())
    jobs = {name: sum(row["stage_seconds"].values()) for name, row in rows.items() if "stage_seconds" in row}
    every_s = JobSettings().poll_interval_s
    costs = Costs(tuple(jobs.values()), running * every_s, job_s, every_s, _DATABASE_CORES)
    simulated = [{"workers": workers, **asdict(simulate(workers, costs))} for workers in _WORKERS]
    for row in simulated:
        print(row, flush=True)
    calls = stored_seconds(options.stored)
    beside = replace(costs, job_s=job_s + calls["post"].database, cleaning_s=calls["minute"].database)
    stored = Stored(
        options.stored,
        _objects(),
        statistics.mean(row["bytes"] for row in rows.values() if "bytes" in row),
        (calls["minute"].database, calls["minute"].caller),
        (calls["hour"].database, calls["hour"].caller),
        max(_served("a cold scene of 1M Gaussians")["seconds"]),
    )
    days = [asdict(day(nodes, beside, stored)) for nodes in _NODES]
    for row in days:
        print(row, flush=True)
    measured = {"waiting": waiting, "running": running, "job": job_s}
    document = {
        "database_cpu_s": measured,
        "jobs": jobs,
        "costs": asdict(costs),
        "rows": simulated,
        "calls": {name: asdict(seconds) for name, seconds in calls.items()},
        "stored": asdict(stored),
        "supposed": asdict(Supposed()),
        "nodes": days,
    }
    write_results("workers", start, options, NOT_CHOSEN, document)
    print(RESULTS / "workers.json")


def measure(workers: int, seconds: float, jobs: int) -> tuple[float, float, float]:
    """Seconds of the database's processors: a worker takes in a second while it waits, the same while it trains, and of
    a job that does nothing."""
    with tempfile.TemporaryDirectory() as folder, closing(PostgresServer()) as server, server.database() as url:
        deployment = Deployment(Path(folder), url)
        intervals = JobSettings(niceness=1).model_dump_json(include=set(settings_of(JobSettings)))
        try:
            for _ in range(workers):
                deployment.start_worker(FASTSPLAT_JOBS=intervals)
            store = deployment.service._store
            deployment.wait_for(lambda: len(store.workers.list_workers()) == workers)

            def over(begun: float, patience_s: float) -> float:
                before = cpu_seconds(server)
                time.sleep(max(0.0, begun + patience_s - time.monotonic()))
                return cpu_seconds(server) - before

            waiting = over(time.monotonic(), seconds) / (workers * seconds)
            sleeping = [deployment.post(f"training:sleep {3 * seconds}") for _ in range(workers)]
            for operation in sleeping:
                deployment.wait_in("training", operation)
            running = over(time.monotonic(), seconds) / (workers * seconds)
            _wait(deployment, sleeping)
            before, begun = cpu_seconds(server), time.monotonic()
            _wait(deployment, [deployment.post() for _ in range(jobs)])
            lasted = time.monotonic() - begun
            once = (cpu_seconds(server) - before - waiting * workers * lasted) / jobs
        finally:
            deployment.close()
    return waiting, running, max(once, 0.0)


def _objects() -> int:
    """Objects that a store holds of the sample scene: its files and a manifest."""
    with sample_folder() as folder:
        (version,) = folder.glob("scenes/*/*")
        return 1 + sum(path.is_file() for path in version.rglob("*"))


def _served(phase: str) -> Mapping[str, Any]:
    rows = json.loads((ROOT / "benchmarks/results/serve.json").read_text())["rows"]
    return next(row for row in rows if row["phase"] == phase)


def _wait(deployment: Deployment, posted: Sequence[Operation]) -> None:
    deployment.wait_for(lambda: {deployment.state(operation) for operation in posted} == {"SUCCEEDED"}, 1200.0)


if __name__ == "__main__":
    main()
