"""How much each entry point loads before it does its work: what a command waits for, and what a process holds."""

from __future__ import annotations

import ast
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

_ROOT = Path(__file__).parent.parent
_OURS = ("fastsplat", "fastsplat_client", "fastsplat_contract")
_HEAVY = ("torch", "pycolmap", "onnxruntime", "sqlalchemy", "scipy", "cv2", "grpc", "fastapi", "httpx")
_COMMAND = """
import sys
sys.argv = ["fastsplat", *{words!r}]
from fastsplat.cli.entry import main
try:
    main()
except SystemExit as ended:
    assert (ended.code or 0) == {status}, ended
"""
_COUNT = """
import json, sys
packages = [
    name.partition(".")[0]
    for name, module in sys.modules.items()
    if "." not in name or "__path__" not in vars(module)  # folders hold nothing
]
print("\\n" + json.dumps({name: packages.count(name) for name in %r}))
"""


_SERVER_LIST = "scenes list --ca none --server http://localhost".split()
_BUDGETS = {
    "package": ("import fastsplat", 1, ""),
    "settings": ("import fastsplat.service.settings", 22, ""),
    "help": (_COMMAND.format(words=["--help"], status=0), 77, ""),
    "keys list": (_COMMAND.format(words=["keys", "list"], status=0), 358, "sqlalchemy scipy cv2 grpc fastapi httpx"),
    "scenes list of a server": (_COMMAND.format(words=_SERVER_LIST, status=2), 100, "grpc httpx"),
    "trainer": ("import fastsplat.workers.engine.trainer", 4, ""),
    "supervisor": ("import fastsplat.workers.engine.supervisor", 70, "sqlalchemy"),
    "answers": ("import fastsplat.service.query.scene_index", 94, "scipy cv2"),
    "server": ("import fastsplat.api.server", 317, "sqlalchemy scipy cv2 grpc fastapi"),
}
"""Entry points: what runs, how many modules of ours it may load, and which of the large packages."""


@pytest.mark.parametrize("name", _BUDGETS)
def test_an_entry_point_loads_what_it_needs(name: str, tmp_path: Path) -> None:
    entry, most, heavy = _BUDGETS[name]
    command = [sys.executable, "-c", entry + _COUNT % ((*_OURS, *_HEAVY),)]
    environment = {**os.environ, "FASTSPLAT_DATA_DIR": str(tmp_path / "data")}
    done = subprocess.run(command, env=environment, cwd=_ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    loaded = json.loads(done.stdout.splitlines()[-1])
    assert {package for package in _HEAVY if loaded[package]} <= set(heavy.split())
    assert sum(loaded[package] for package in _OURS) <= most


def test_packages_load_nothing_of_their_own() -> None:
    """Else whoever wants one module of a package waits for all that its `__init__` names."""
    tracked = subprocess.run(["git", "ls-files", "*__init__.py"], cwd=_ROOT, capture_output=True, text=True, check=True)
    packages = [name for name in tracked.stdout.split() if name.split("/")[0] in ("api", "cli", "service", "workers")]
    assert len(packages) > 20
    full = {name for name in packages if len(ast.parse((_ROOT / name).read_text()).body) > 1}
    assert full == {"service/store/rows/migrations/__init__.py"}
