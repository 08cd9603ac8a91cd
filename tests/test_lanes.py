"""The two lanes of tests: their table names what is there, and pytest goes by it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from tests import lanes

ROOT = Path(__file__).parent.parent
_TESTS = ROOT / "tests"
_CONFTEST = """
from tests import lanes

def pytest_configure(config):
    config.pluginmanager.register(lanes)
"""
_WHERE = """
import os
import numpy
import pytest

@pytest.mark.parametrize("array", [numpy.zeros(2)])
@pytest.mark.parametrize("database", ["sqlite", "postgresql"])
@pytest.mark.parametrize("number", range(6))
def test_it(number, database, array):
    with open({log!r}, "a") as log:
        print({name!r}, database, os.getpid(), file=log)
"""


_FILES = (
    "web/objects/test_ask.py web/viewer/test_look.py web/test_journey.py scene/test_ply.py scene/test_spz.py".split()
)
_INI = "[pytest]\ntestpaths = tests\naddopts = --import-mode=importlib\nmarkers = rest: by tests/lanes.py\n"


def _run(folder: Path, *words: str) -> tuple[str, int, list[list[str]]]:
    """What a pytest over small files says, its exit status, and of each test: its file, its database, its process."""
    log = folder / "log.txt"
    log.unlink(missing_ok=True)
    for name in _FILES:
        file = folder / "tests" / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(_WHERE.format(log=str(log), name=name))
    (folder / "conftest.py").write_text(_CONFTEST)
    (folder / "pytest.ini").write_text(_INI)
    paths = os.pathsep.join((str(ROOT), str(ROOT / "client")))
    environment = {**os.environ, "PYTHONPATH": paths, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    command = [sys.executable, "-m", "pytest", "-q", "-p", "xdist", *words]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    assert log.is_file(), done.stdout + done.stderr
    return done.stdout, done.returncode, [line.split() for line in log.read_text().splitlines()]


def test_the_tables_name_what_is_there() -> None:
    missing = [name for name in (*lanes.REST, *lanes.FIRST, *lanes.TOGETHER) if not (_TESTS / name).exists()]
    assert missing == []
    files = {lanes.relative_path(str(path.relative_to(ROOT))) for path in _TESTS.rglob("test_*.py")}
    assert set(lanes.FIRST) <= files
    assert set(lanes.LONG) <= {lanes.group(path) for path in files}


def test_each_test_is_in_one_lane_and_postgresql_in_the_rest(tmp_path: Path) -> None:
    _, _, now = _run(tmp_path, "-m", "not rest")
    _, _, later = _run(tmp_path, "-m", "rest")
    _, _, everything = _run(tmp_path)
    assert {(name, database) for name, database, _ in now} == {(name, "sqlite") for name in _FILES[2:]}
    assert sorted(row[:2] for row in now + later) == sorted(row[:2] for row in everything) and len(everything) == 60
    assert {name for name, _, _ in everything[:24]} == set(_FILES[:2])  # long ones begin


def test_a_group_and_a_file_without_one_stay_in_one_process(tmp_path: Path) -> None:
    said, status, ran = _run(tmp_path, "--numprocesses", "3", "--dist", "loadgroup", "--no-loadscope-reorder")
    assert status == 0, said
    processes = {name: {process for file, _, process in ran if file == name} for name, _, _ in ran}
    assert len(processes) == 5 and all(len(ids) == 1 for ids in processes.values())
    assert processes["web/objects/test_ask.py"] == processes["web/viewer/test_look.py"]
    assert len({*map(tuple, processes.values())}) == 3
