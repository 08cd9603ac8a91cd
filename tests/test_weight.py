"""Rows of rooms may be raised, where one sees it; sums only go down. `python -m tests.test_weight` prints both."""

from __future__ import annotations

import ast
import re
import subprocess
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
import typer

from fastsplat.cli.main import app
from fastsplat_contract.calls import CALLS

ROOT = Path(__file__).parent.parent

ROWS: Mapping[str, tuple[int, int]] = {
    "api": (5626, 11172),
    "application": (6597, 3142),
    "benchmarks": (0, 2794),
    "capture": (11016, 6567),
    "cli": (3508, 1958),
    "client": (8655, 1691),
    "common": (1360, 659),
    "demo": (0, 166),
    "docker": (0, 314),
    "docs": (0, 805),
    "fastsplat": (31, 0),
    "instances": (2383, 1901),
    "interop": (0, 506),
    "jobs": (1670, 515),
    "library": (535, 392),
    "localization": (1716, 611),
    "perception": (5380, 3068),
    "planning": (799, 451),
    "query": (11871, 7188),
    "release": (0, 171),
    "scene": (3344, 1486),
    "service": (374, 0),
    "splat_import": (625, 310),
    "splatting": (5643, 4584),
    "store": (4857, 1950),
    "tests": (0, 1925),
    "web": (0, 4261),
    "workers": (2581, 3888),
}
"""Lines of a room and of its tests, at most."""
SUMS = {"product": 78571, "tests": 62475, "page": 15907, "C++": 4481, "calls": 56, "commands": 67}
"""What all rooms together may hold."""

_PRODUCT = ("api", "cli", "client", "fastsplat", "service", "workers")


def _room(path: Path) -> str:
    """The room of a file of the product, or of a test: a folder of the product or of `service`."""
    parts = path.parts[1:] if path.parts[0] == "tests" else path.parts
    if path.parts[0] == "service":
        return parts[1] if len(parts) > 2 else "service"
    return "client" if parts[0] == "contract" else parts[0] if len(parts) > 1 else "tests"


def _weights() -> tuple[dict[str, tuple[int, int]], dict[str, int]]:
    """The table and its foot, as the tree is now."""
    product, tests = Counter[str](), Counter[str]()
    rest = Counter[str]()
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for path in map(Path, listed.splitlines()):
        if not (ROOT / path).is_file() or "_pb2" in path.name:
            continue
        if path.suffix == ".py" and path.parts[0] in (*_PRODUCT, "tests"):
            (tests if path.parts[0] == "tests" else product)[_room(path)] += _lines(path)
        elif path.suffix in (".cpp", ".h"):
            rest["C++"] += _lines(path)
        elif path.suffix in (".ts", ".tsx", ".css") and path.is_relative_to("api/web/src"):
            rest["page"] += _lines(path)
    rows = {room: (product[room], tests[room]) for room in sorted({*product, *tests})}
    sums = {"product": product.total(), "tests": tests.total(), **rest}
    return rows, sums | {"calls": len(CALLS), "commands": _commands(typer.main.get_command(app))}


def _commands(command: Any) -> int:
    """How many commands a command or group of commands is."""
    inner = getattr(command, "commands", None)
    return 1 if inner is None else sum(map(_commands, inner.values()))


def _lines(path: Path) -> int:
    return (ROOT / path).read_bytes().count(b"\n")


def test_no_room_is_heavier_than_its_row() -> None:
    rows, _ = _weights()
    assert rows.keys() == ROWS.keys()
    assert not {room: now for room, now in rows.items() if now[0] > ROWS[room][0] or now[1] > ROWS[room][1]}


@pytest.mark.parametrize("what", SUMS)
def test_the_whole_is_no_heavier_than_its_sum(what: str) -> None:
    _, sums = _weights()
    assert sums[what] <= SUMS[what]


def test_sums_only_go_down() -> None:
    """Over all commits of this file that are here."""
    path = Path(__file__).relative_to(ROOT)
    commits = subprocess.run(
        ["git", "log", "--format=%h", "--", path], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.split()
    for commit in commits:
        text = subprocess.run(
            ["git", "show", f"{commit}:{path}"], cwd=ROOT, capture_output=True, text=True, check=True
        ).stdout
        before = ast.literal_eval(re.findall(r"^SUMS = (.*)", text, re.MULTILINE)[0])
        assert not {name: commit for name, most in before.items() if most and SUMS.get(name, 0) > most}


if __name__ == "__main__":
    for room, (product, tests) in (table := _weights())[0].items():
        print(f'    "{room}": ({product}, {tests}),')
    print(f"SUMS = {table[1]}")
