"""CITATION.cff names this release, and the paper as the README's BibTeX does."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import yaml

_ROOT = Path(__file__).parents[2]


def test_it_names_this_release_and_the_readmes_paper() -> None:
    cited = yaml.safe_load((_ROOT / "CITATION.cff").read_text())
    project = tomllib.loads((_ROOT / "pyproject.toml").read_text())["project"]
    assert (cited["version"], cited["license"]) == (project["version"], project["license"])
    entry = re.search(r"@article\{.*?\n\}", (_ROOT / "README.md").read_text(), re.DOTALL)
    fields = dict(re.findall(r"(\w+)\s*= \{(.*)\},?$", entry[0], re.MULTILINE))
    paper = cited["preferred-citation"]
    assert paper["title"] == re.sub("[{}]", "", fields["title"])
    assert paper["journal"] == fields["journal"] and str(paper["year"]) == fields["year"]
    names = [f"{author['family-names']}, {author['given-names']}" for author in paper["authors"]]
    assert " and ".join(names) == fields["author"]
