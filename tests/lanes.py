"""Decides by folder and file which tests `make test` runs, and in which order."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from xdist.scheduler import LoadScopeScheduling

REST = (
    "api/grpc/test_fuzz.py", "api/grpc/test_stream_reconnection.py", "api/programs/test_client_interpreters.py",
    "api/rest/test_fuzz.py", "api/scenes/test_localize.py", "api/scenes/test_observations.py",
    "api/server/test_dropped_answers.py", "api/server/test_slow_clients.py", "api/server/test_stopping.py",
    "api/uploads/test_full_disk.py", "api/uploads/test_many_uploads.py", "application/test_memory.py", "benchmarks/",
    "capture/sfm/test_early_refusal.py", "capture/sfm/test_reconstruction.py", "capture/sfm/test_repetition.py",
    "capture/world/test_scale_tags.py", "cli/test_mcp_sample.py",
    "cli/test_serve.py", "client/test_wheel.py", "docker/", "docs/", "interop/", "jobs/test_by_default.py",
    "jobs/test_looking_again.py", "library/test_library_training.py", "localization/test_changes.py",
    "perception/test_mask_proposals.py", "perception/test_pull.py", "splatting/raster/test_raster_arm64.py",
    "splatting/training/test_host_discipline.py", "splatting/training/test_pruning.py", "web/", "workers/",
)  # fmt: skip
"""Folders and files, below tests/, that `make test` leaves out: real processes but one server, browsers, trainings of
whole captures, benchmarks, documents, packages, images, other programs."""

FIRST = (  # their files that `make test` runs all the same: one journey with a real worker, and what needs none
    "docs/test_examples_of_docstrings.py", "docs/test_page_blocks.py", "web/test_journey.py",
    "benchmarks/test_sample_answers.py", "web/test_page_sources.py", "workers/kinds/test_budget.py",
    "workers/kinds/test_damaged_results.py", "workers/engine/test_periodic.py",
)  # fmt: skip

TOGETHER = {
    "web/": "web",  # one server and one browser
    "web/test_journey.py": "web with workers",
    "web/test_trouble.py": "web with workers",
    "web/test_page_sources.py": "the page's sources",
}
"""Files and folders of one process, by group; others: one a file. (Marks: pytest-xdist 3.8 fails under pytest 9.2.)"""

LONG = (  # groups that start before all others, so that none is left to the end
    "workers/engine/test_ray_cluster.py", "docs/test_pages.py", "web", "web with workers", "test_code_quality.py",
    "workers/engine/test_crashes.py", "capture/sfm/test_reconstruction.py", "workers/kinds/test_real_stages.py",
    "workers/engine/test_backup.py", "workers/engine/test_jobs.py", "api/programs/test_client_interpreters.py",
    "api/grpc/test_stream_reconnection.py", "library/test_library_training.py", "the page's sources",
)  # fmt: skip


def relative_path(nodeid: str) -> str:
    """A test's file below tests/."""
    return nodeid.partition("::")[0].removeprefix("tests/")


def _is_left_out(path: str) -> bool:
    return path not in FIRST and path.startswith(REST)


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """`make test` does not import what it leaves out."""
    if config.option.markexpr != "not rest" or collection_path.suffix != ".py":
        return None
    return _is_left_out(relative_path(collection_path.relative_to(config.rootpath).as_posix())) or None


def is_rest(item: pytest.Item) -> bool:
    """Whether `make test` leaves a test out: by its place, or because it needs a PostgreSQL server."""
    if _is_left_out(relative_path(item.nodeid)):
        return True
    callspec = getattr(item, "callspec", None)
    on_postgresql = callspec is not None and any(
        isinstance(value, str) and value == "postgresql" for value in callspec.params.values()
    )
    return on_postgresql or "postgres" in getattr(item, "fixturenames", ())


def group(nodeid: str) -> str:
    """What stays in one process: the files that `TOGETHER` names, else those of one file."""
    path = relative_path(nodeid)
    return TOGETHER.get(path) or next(
        (name for beginning, name in TOGETHER.items() if path.startswith(beginning)), path
    )


@pytest.hookimpl(tryfirst=True)  # before pytest chooses by marks, and pytest-xdist reads its groups
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what `make test` leaves out, and bring long groups to the front."""
    for item in items:
        if is_rest(item):
            item.add_marker("rest")
    place = {name: number for number, name in enumerate(LONG)}
    order = [group(item.nodeid) for item in items]
    first = {name: number for number, name in reversed(list(enumerate(order)))}
    ranked = sorted(range(len(items)), key=lambda at: (place.get(order[at], len(place)), first[order[at]], at))
    items[:] = [items[at] for at in ranked]


class ByGroup(LoadScopeScheduling):
    """Of pytest-xdist: gives each group to one process."""

    def _split_scope(self, nodeid: str) -> str:
        return group(nodeid)


def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> ByGroup | None:
    """The scheduler of `--dist loadgroup`."""
    return ByGroup(config, log) if config.getvalue("dist") == "loadgroup" else None
