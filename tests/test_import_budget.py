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


@pytest.mark.parametrize(
    ("entry", "most", "heavy"),
    [
        ("import fastsplat", 1, set()),
        ("import fastsplat.service.settings", 22, set()),
        (_COMMAND.format(words=["--help"], status=0), 77, set()),
        (
            _COMMAND.format(words=["keys", "list"], status=0),
            358,
            {"sqlalchemy", "scipy", "cv2", "grpc", "fastapi", "httpx"},
        ),
        (
            _COMMAND.format(words=[*"scenes list --ca none --server http://localhost".split()], status=2),
            100,
            {"grpc", "httpx"},
        ),
        ("import fastsplat.workers.engine.trainer", 4, set()),
        ("import fastsplat.workers.engine.supervisor", 70, {"sqlalchemy"}),
        ("import fastsplat.service.query.scene_index", 94, {"scipy", "cv2"}),
        ("import fastsplat.api.server", 317, {"sqlalchemy", "scipy", "cv2", "grpc", "fastapi"}),
    ],
    ids=[
        "package", "settings", "help", "keys list", "keys list of a server", "trainer", "supervisor", "answers",
        "server",
    ],
)  # fmt: skip
def test_an_entry_point_loads_what_it_needs(entry: str, most: int, heavy: set[str], tmp_path: Path) -> None:
    """At most so many modules of ours, and of the large packages none but these."""
    command = [sys.executable, "-c", entry + _COUNT % ((*_OURS, *_HEAVY),)]
    environment = {**os.environ, "FASTSPLAT_DATA_DIR": str(tmp_path / "data")}
    done = subprocess.run(command, env=environment, cwd=_ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    loaded = json.loads(done.stdout.splitlines()[-1])
    assert {name for name in _HEAVY if loaded[name]} <= heavy
    assert sum(loaded[name] for name in _OURS) <= most


def test_packages_load_nothing_of_their_own() -> None:
    """Else whoever wants one module of a package waits for all that its `__init__` names."""
    tracked = subprocess.run(["git", "ls-files", "*__init__.py"], cwd=_ROOT, capture_output=True, text=True, check=True)
    packages = [name for name in tracked.stdout.split() if name.split("/")[0] in ("api", "cli", "service", "workers")]
    assert len(packages) > 20
    full = {name for name in packages if len(ast.parse((_ROOT / name).read_text()).body) > 1}
    assert full == {"service/store/rows/migrations/__init__.py"}
