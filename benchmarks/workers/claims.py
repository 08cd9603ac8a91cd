"""Milliseconds of a claim while many jobs wait: `python -m benchmarks.workers.claims`, on SQLite and PostgreSQL."""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
import uuid
from contextlib import closing
from pathlib import Path

from sqlalchemy import insert

from fastsplat.service.store.repositories.scene_repository import order_job, queued_row
from fastsplat.service.store.rows.schema import operations
from fastsplat.service.store.store import open_store
from tests.postgres import PostgresServer


def claim_ms(database_url: str, jobs: int, projects: int, claims: int) -> list[float]:
    """Milliseconds of each claim of one worker, with so many queued jobs of so many projects."""
    with tempfile.TemporaryDirectory() as folder, closing(open_store(Path(folder), database_url)) as store:
        rows = [queued_row(order_job("look_again", uuid.uuid4().hex, "", {}, f"p{n % projects}")) for n in range(jobs)]
        with store.engine.begin() as connection:
            connection.execute(insert(operations), rows)
        taken = []
        for _ in range(claims):
            begun = time.perf_counter()
            claim = store.jobs.claim_next("worker")
            taken.append(1e3 * (time.perf_counter() - begun))
            assert claim is not None
        return taken


def main() -> None:
    """Measure, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--jobs", type=int, default=10_000)
    parser.add_argument("--claims", type=int, default=200)
    options = parser.parse_args()
    with closing(PostgresServer()) as server:
        for projects in (1, 20, 200):
            for name in ("sqlite", "postgresql"):
                with server.database() as url:
                    taken = claim_ms(url if name == "postgresql" else "", options.jobs, projects, options.claims)
                median, most = statistics.median(taken), max(taken)
                print(f"{name}, {options.jobs} jobs of {projects} projects: median {median:.2f} ms, most {most:.2f} ms")


if __name__ == "__main__":
    main()
