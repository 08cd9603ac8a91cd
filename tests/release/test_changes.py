"""Changelog fragments: each is of a kind that the changelog has, and says something in one sentence or a few; a change
of the product without one is refused."""

from __future__ import annotations

import re
import subprocess
import tomllib
from pathlib import Path

_ROOT = Path(__file__).parents[2]
_MOST = 400
"""Characters: longer belongs into the docs."""


def faults_of(folder: Path, kinds: set[str]) -> list[str]:
    """What is wrong with the fragments in `folder`."""
    found = []
    for path in sorted(folder.glob("*")):
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


def test_a_change_of_the_product_since_the_last_release_needs_a_fragment(tmp_path: Path) -> None:
    def git(*words: str) -> None:
        author = ("-c", "user.name=A", "-c", "user.email=a@example.org")
        subprocess.run(["git", *author, *words], cwd=tmp_path, check=True, capture_output=True)

    def commit(name: str, text: str) -> None:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text + "\n")
        git("add", "--all")
        git("commit", "--message", "A change")

    def refused(*base: str) -> str:
        done = subprocess.run(
            [_ROOT / "release/check_fragments.sh", *base], cwd=tmp_path, capture_output=True, text=True
        )
        assert (done.returncode == 1) == bool(done.stderr), done
        return done.stderr

    git("init", "--initial-branch=main")
    commit("service/one.py", "1")
    commit("changes/+one.added.md", "One.")
    commit("pyproject.toml", 'version = "1.0.0"')
    assert not refused()
    commit("tests/test_one.py", "1")
    commit("docs/one.md", "1")
    assert not refused(), "what is beside the product needs no fragment"
    commit("service/one.py", "2")
    assert "\nservice/one.py\n" in refused() and "changes/" in refused(), "the fragment of before does not count"
    commit("pyproject.toml", 'version = "1.0.0"\ndependencies = []')
    assert "\nservice/one.py\n" in refused(), "another line than the version's"
    commit("changes/+one.added.md", "One and two.")
    assert not refused() and not refused("HEAD")
    git("tag", "v1.0.1")
    commit("changes/+three.mended.md", "Three.")
    commit("service/one.py", "3")
    assert not refused()
    assert "\nservice/one.py\n" in refused("HEAD~1")
    git("tag", "v1.1.0")
    (tmp_path / "changes/+three.mended.md").unlink()
    commit("service/one.py", "4")
    assert "\nservice/one.py\n" in refused(), "a fragment that goes is none that comes"
    commit("CHANGELOG.md", "Four.")
    assert not refused(), "the changelog says it itself"
