"""What must be on a machine first is asked for at once, before anything is downloaded."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
_SCRIPT = ROOT / "demo" / "check_machine.sh"
_ALL = ("Python 3.11 to 3.14", "C++17 compiler", "make", "Node.js 18.19")


@pytest.fixture
def machine(tmp_path: Path) -> Path:
    """The only folder of programs of a machine that has a shell and nothing else."""
    (tmp_path / "sh").symlink_to(shutil.which("sh") or "")
    return tmp_path


def _check(machine: Path, *words: str) -> tuple[int, list[str]]:
    done = subprocess.run(
        [_SCRIPT, *words], env={"PATH": str(machine)}, capture_output=True, text=True, check=False, timeout=60
    )
    return done.returncode, [line for line in done.stderr.splitlines() if line.startswith("  - ")]


def _program(machine: Path, name: str, does: str) -> None:
    (machine / name).write_text(f"#!/bin/sh\n{does}\n")
    (machine / name).chmod(0o755)


def test_all_that_is_missing_is_named_in_one_message(machine: Path) -> None:
    status, missing = _check(machine, "python3", "page")
    assert status == 1 and len(missing) == len(_ALL)
    assert all(name in line for name, line in zip(_ALL, missing, strict=True))


def test_without_node_only_the_page_is_refused(machine: Path) -> None:
    for name in ("make", "c++"):
        _program(machine, name, "exit 0")
    for words, status in (((), 0), (("page",), 1)):
        found, missing = _check(machine, sys.executable, *words)
        assert found == status and len(missing) == 1 and "Node.js" in missing[0]


@pytest.mark.parametrize(("name", "does"), [("c++", "exit 1"), ("node", "exit 1")])
def test_what_is_too_old_is_missing(machine: Path, name: str, does: str) -> None:
    for program in ("make", "c++", "node", "npm"):
        _program(machine, program, does if program == name else "exit 0")
    _, missing = _check(machine, sys.executable, "page")
    assert len(missing) == 1


def test_make_checks_before_it_downloads() -> None:
    rules = re.findall(r"^(\$\(VENV\)/\.\w+):.*\n((?:\t.*\n)+)", (ROOT / "Makefile").read_text(), re.MULTILINE)
    assert [name for name, _ in rules] == ["$(VENV)/.product", "$(VENV)/.installed"]
    assert all(recipe.startswith("\t@demo/check_machine.sh") for _, recipe in rules)


def test_make_knows_the_pythons_that_run_where_a_later_one_is_missing(machine: Path) -> None:
    for name in ("python3.11", "python3.12"):
        _program(machine, name, "exit 0")
    _program(machine, "python3.14", "exit 127")  # as a shim of pyenv does for a version that is not there
    result = subprocess.run(
        [shutil.which("make") or "make", "--print-data-base", "--dry-run", "help"],
        env={"PATH": str(machine)}, cwd=ROOT, capture_output=True, text=True, check=False, timeout=60,
    )  # fmt: skip
    assert "\nPYTHONS := python3.11 python3.12\n" in result.stdout
