"""Prints and stores how long each folder's tests take; machines differ fourfold, so nothing fails by it."""

from __future__ import annotations

import json
import resource
from collections import defaultdict
from collections.abc import Generator
from typing import Any

import pytest

from tests import lanes

_CPU = "cpu_seconds"
_FILE = "seconds_by_file.json"  # in the cache folder of pytest: [seconds, seconds of CPU] of each file


class SecondsByFolder:
    """Counts time and CPU time (with waited-for children) of tests and fixtures over pytest-xdist's processes."""

    def __init__(self, config: pytest.Config) -> None:
        self._config = config
        self._began = 0.0
        self._spent: dict[str, list[float]] = defaultdict(lambda: [0.0, 0.0])

    def pytest_runtest_logstart(self) -> None:
        self._began = _cpu_seconds()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(
        self, call: pytest.CallInfo[None]
    ) -> Generator[None, pytest.TestReport, pytest.TestReport]:
        report = yield
        if call.when == "teardown":
            report.user_properties.append((_CPU, _cpu_seconds() - self._began))
        return report

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        spent = self._spent[lanes.relative_path(report.nodeid)]
        spent[0] += report.duration
        spent[1] += sum(float(str(value)) for name, value in report.user_properties if name == _CPU)

    def pytest_sessionfinish(self) -> None:
        if hasattr(self._config, "workerinput") or not self._spent:
            return
        if (cache := getattr(self._config, "cache", None)) is not None:
            cache.mkdir("seconds").joinpath(_FILE).write_text(json.dumps(self._spent, indent=1, sort_keys=True))

    def pytest_terminal_summary(self, terminalreporter: Any) -> None:
        if not self._spent:
            return
        terminalreporter.section("minutes by folder: of processes that wait or compute, and of CPU")
        folders = self._by_folder()
        for name, (wall, cpu) in sorted(folders.items(), key=lambda row: -row[1][1]):
            terminalreporter.write_line(f"{name or 'tests':<14}{wall / 60:>7.2f}{cpu / 60:>7.2f}")
        wall, cpu = (sum(row[column] for row in folders.values()) for column in (0, 1))
        terminalreporter.write_line(f"{'all':<14}{wall / 60:>7.2f}{cpu / 60:>7.2f}")

    def _by_folder(self) -> dict[str, tuple[float, float]]:
        folders: dict[str, tuple[float, float]] = {}
        for path, (wall, cpu) in self._spent.items():
            name = lanes.folder(path)
            before = folders.get(name, (0.0, 0.0))
            folders[name] = (before[0] + wall, before[1] + cpu)
        return folders


def _cpu_seconds() -> float:
    of_both = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(usage.ru_utime + usage.ru_stime for usage in of_both)
