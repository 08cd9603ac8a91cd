"""Every measurement says where it comes from, and every benchmark loads."""

from __future__ import annotations

import argparse
import importlib
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.provenance import ROOT, begin, commit, provenance, write_json

MODULES = sorted(
    ".".join(path.relative_to(ROOT).with_suffix("").parts)
    for path in (ROOT / "benchmarks").rglob("*.py")
    if path.name != "__init__.py"
)


@pytest.mark.parametrize("name", MODULES)
def test_a_benchmark_loads(name: str) -> None:
    importlib.import_module(name)


def test_a_measurement_names_where_it_comes_from_and_what_its_settings_were_chosen_on(tmp_path: Path) -> None:
    options = argparse.Namespace(out=tmp_path / "out.json", seconds=[1.5], deep={"folder": tmp_path / "a"}, only=("b",))
    about = provenance(begin(), settings=options, chosen_on="nothing")
    assert set(about) == {
        "command", "settings", "chosen_on", "machine", "commit", "date", "seconds", "load_before", "load_after",
    }  # fmt: skip
    assert about["settings"] == {"out": "out.json", "seconds": [1.5], "deep": {"folder": "a"}, "only": ["b"]}
    assert about["chosen_on"] == "nothing" and about["seconds"] >= 0
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\+00:00", about["date"])
    assert about["load_before"] >= 0 <= about["load_after"] and "threads" in about["machine"]
    write_json(tmp_path / "deep" / "out.json", about)
    assert json.loads((tmp_path / "deep" / "out.json").read_text()) == about
    assert [path.name for path in (tmp_path / "deep").iterdir()] == ["out.json"]


def test_the_command_is_as_typed_without_folders_of_this_machine(tmp_path: Path) -> None:
    program = tmp_path / "probe" / "__main__.py"
    program.parent.mkdir()
    program.write_text("from benchmarks.provenance import command\nprint(command())")
    words = [sys.executable, "-m", "probe", str(tmp_path / "data"), "--rounds", "3"]
    done = subprocess.run(
        words, capture_output=True, text=True, check=True, cwd=tmp_path, env={"PYTHONPATH": f"{ROOT}:{tmp_path}"}
    )
    assert done.stdout.strip() == "python -m probe data --rounds 3"


def test_the_commit_says_when_files_differ_from_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def git(*words: str) -> None:
        subprocess.run(["git", "-c", "user.name=a", "-c", "user.email=a@b", *words], cwd=tmp_path, check=True)

    monkeypatch.setattr("benchmarks.provenance.ROOT", tmp_path)
    assert commit() == "unknown"
    git("init", "--quiet")
    (tmp_path / "file").write_text("one")
    git("add", "file")
    git("commit", "--quiet", "-m", "first")
    assert re.fullmatch(r"[0-9a-f]{12}", commit())
    (tmp_path / "file").write_text("two")
    assert re.fullmatch(r"[0-9a-f]{12} \+ changes", commit())
