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

from benchmarks import provenance as module
from benchmarks.provenance import ROOT, UncommittedError, begin, commit, provenance, write_json

MODULES = sorted(
    ".".join(path.relative_to(ROOT).with_suffix("").parts)
    for path in (ROOT / "benchmarks").rglob("*.py")
    if path.name != "__init__.py"
)


@pytest.mark.parametrize("name", MODULES)
def test_a_benchmark_loads(name: str) -> None:
    importlib.import_module(name)


def test_a_measurement_names_where_it_comes_from_and_what_its_settings_were_chosen_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "DRAFT", str(tmp_path))  # this tree may differ from its commit
    options = argparse.Namespace(out=tmp_path / "out.json", seconds=[1.5], deep={"folder": tmp_path / "a"}, only=("b",))
    about = provenance(begin(), settings=options, chosen_on="nothing")
    assert set(about) == {
        "command", "settings", "chosen_on", "machine", "commit", "date", "sources", "seconds",
        "load_before", "load_after",
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


@pytest.fixture
def tree(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A repository with one commit, which is what is measured."""
    monkeypatch.setattr(module, "ROOT", tmp_path)
    (tmp_path / "benchmarks" / "results").mkdir(parents=True)
    for name in ("file", "benchmarks/results/rows.json"):
        (tmp_path / name).write_text("one")
    for words in (("init", "--quiet"), ("add", "."), ("commit", "--quiet", "-m", "first")):
        subprocess.run(["git", "-c", "user.name=a", "-c", "user.email=a@b", *words], cwd=tmp_path, check=True)
    return tmp_path


def test_the_commit_says_when_files_differ_from_it(tree: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert re.fullmatch(r"[0-9a-f]{12}", commit())
    (tree / "benchmarks" / "results" / "rows.json").write_text("two")
    assert re.fullmatch(r"[0-9a-f]{12}", commit()), "a row that was just measured is no change of what is measured"
    (tree / "file").write_text("two")
    assert re.fullmatch(r"[0-9a-f]{12} \+ changes", commit())
    monkeypatch.setattr(module, "ROOT", tree.parent)
    assert commit() == "unknown"


def test_nothing_is_measured_of_what_no_commit_holds(tree: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "DRAFT", "")
    start = begin()
    (tree / "file").write_text("two")
    assert provenance(start, settings={}, chosen_on="")["commit"] == start.commit, "that of when it began"
    with pytest.raises(UncommittedError, match="Commit first"):
        begin()
    monkeypatch.setattr(module, "ROOT", tree.parent)
    with pytest.raises(UncommittedError, match="unknown"):
        begin()
    monkeypatch.setattr(module, "DRAFT", str(tree / "trial"))
    assert begin().commit == "unknown"


def test_a_file_of_results_holds_nothing_that_names_no_origin(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    about = dict.fromkeys(("command", "commit", "machine", "date", "load_before"), "")
    out, old, new = tmp_path / "out.json", {"psnr": 1.0}, {"psnr": 2.0, **about}
    for document, result in (
        ({"a": old, "b": new}, {"b": new}),
        ({"note": "", "rows": [old, new]}, {"note": "", "rows": [new]}),
        ({"rows": {"a": old, "b": {"provenance": about}}}, {"rows": {"b": {"provenance": about}}}),
        ({**about, "rows": [old]}, {**about, "rows": [old]}),
    ):
        write_json(out, document)
        assert json.loads(out.read_text()) == result
    assert capsys.readouterr().out.count("left out") == 3
    for document in ({"rows": [old]}, {"a": old}, {"value": 1}, {}):
        with pytest.raises(ValueError, match="names its command, commit"):
            write_json(tmp_path / "none.json", document)
    assert not (tmp_path / "none.json").exists()
