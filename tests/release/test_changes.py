"""Changelog fragments: each is of a kind that the changelog has, and says something in one sentence or a few."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

_ROOT = Path(__file__).parents[2]
_MOST = 400
"""Characters: longer belongs into the docs."""


def faults_of(folder: Path, kinds: set[str]) -> list[str]:
    """What is wrong with the fragments in `folder`."""
    found = []
    for path in sorted(folder.iterdir()):
        named = re.fullmatch(r"\+[a-z0-9-]+\.([a-z]+)\.md", path.name)
        text = path.read_text().strip()
        if named is None or named[1] not in kinds:
            found.append(f"{path.name}: not +NAME.KIND.md with a KIND of {sorted(kinds)}")
        elif not text.endswith(".") or len(text) > _MOST:
            found.append(f"{path.name}: not one to {_MOST} characters that end with a period")
    return found


def test_every_fragment_comes_into_the_changelog() -> None:
    settings = tomllib.loads((_ROOT / "pyproject.toml").read_text())["tool"]["towncrier"]
    assert faults_of(_ROOT / settings["directory"], {kind["directory"] for kind in settings["type"]}) == []


def test_what_would_be_lost_or_is_no_sentence_is_found(tmp_path: Path) -> None:
    for name, text in (
        ("+good.added.md", "There is more."),
        ("+kind.news.md", "There is more."),
        ("noted.txt", "There is more."),
        ("+empty.added.md", "\n"),
        ("+long.added.md", "more " * 100 + "."),
    ):
        (tmp_path / name).write_text(text)
    assert [fault.partition(":")[0] for fault in faults_of(tmp_path, {"added"})] == [
        "+empty.added.md",
        "+kind.news.md",
        "+long.added.md",
        "noted.txt",
    ]
