"""Carries out the how-tos of DEVELOPMENT.md in a copy of the sources, and tries what is new there."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.copied_sources import ROOT, copy_sources, insert, run_python

_HOW_TOS = {path.stem.replace("_", " "): path for path in sorted((Path(__file__).parent / "how_to").glob("*.txt"))}
"""By title. A file has insertions: `=== FILE`, `--- ANCHOR` ("": the end), text; and `$ TESTS`, laws to run beside."""


def _steps() -> dict[str, list[str]]:
    """The numbered steps below each title of "How to add"."""
    part = (ROOT / "DEVELOPMENT.md").read_text().split("\n## How to add\n")[1].split("\n## ")[0]
    sections = (section.partition("\n") for section in part.split("\n### ")[1:])
    numbered = {title.lower(): re.findall(r"^\d\. .*", text, re.MULTILINE) for title, _, text in sections}
    return {title: steps for title, steps in numbered.items() if steps}


def _insertions(how_to: str) -> Iterator[tuple[str, str, str]]:
    """File, anchor and text of each insertion."""
    for part in how_to.split("=== ")[1:]:
        file, *insertions = re.split(r"^---(?: |$)", part, flags=re.MULTILINE)
        for insertion in insertions:
            anchor, _, text = insertion.partition("\n")
            yield file.strip(), anchor, text


def test_all_how_tos_are_tried_and_have_four_steps_at_most() -> None:
    steps = _steps()
    assert steps.keys() == _HOW_TOS.keys() and max(map(len, steps.values())) <= 4


@pytest.mark.parametrize("title", _HOW_TOS)
def test_the_steps_suffice(title: str, tmp_path: Path) -> None:
    text, steps = _HOW_TOS[title].read_text(), " ".join(_steps()[title])
    insertions = list(_insertions(text))
    (test,) = {file for file, *_ in insertions if file.endswith("/test_new.py")}
    named = re.findall(r"`((?:api|cli|client|docs|service|tests|workers)/[\w./]*)`", steps)
    places = {
        file: max((name for name in named if file == name or (name.endswith("/") and file.startswith(name))), key=len)
        for file in {file for file, *_ in insertions} - {test}
    }
    assert set(places.values()) == set(named)
    copy_sources(tmp_path, "api", "cli", "client", "docs", "protos", "service", "tests", "workers")
    for file, anchor, inserted in insertions:
        insert(tmp_path / file, anchor, inserted)
    for module in re.findall(r"`python -m ([\w.]+)`", steps):
        run_python(tmp_path, "-m", module)
    laws = shlex.split(" ".join(re.findall(r"^\$ (.*)", text, re.MULTILINE)))
    run_python(tmp_path, "-m", "pytest", "-p", "no:cacheprovider", "-q", test, *laws)
