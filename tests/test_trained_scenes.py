"""Artefacts of training are made once, by one of the processes that want them, and anew when an input changes."""

from __future__ import annotations

import os
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from tests.trained_scenes import trained


def _make(folder: Path) -> None:
    time.sleep(0.1)
    (folder.parent.parent / "made.txt").open("a").write("made\n")
    (folder / "scene").write_text(str(os.getpid()))


def test_an_artefact_is_made_once_for_all_and_anew_for_other_inputs(tmp_path: Path) -> None:
    data, cache = tmp_path / "data", tmp_path / "kept"
    data.mkdir()
    (data / "photo").write_text("one")
    with ThreadPoolExecutor(4) as pool:
        folders = {run.result() for run in [pool.submit(trained, "a", _make, data, folder=cache) for _ in range(4)]}
    assert len(folders) == 1 and (cache / "made.txt").read_text() == "made\n"
    (data / "photo").write_text("another")
    later = trained("a", _make, data, folder=cache)
    assert later not in folders and (cache / "made.txt").read_text() == "made\nmade\n"
    assert not folders.pop().exists() and (later / "scene").is_file()


def test_what_fails_leaves_nothing(tmp_path: Path) -> None:
    def fail(folder: Path) -> None:
        (folder / "half").touch()
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        trained("a", fail, folder=tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["a.lock"]
