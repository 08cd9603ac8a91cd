"""One version, that of client/pyproject.toml, in all that names it; CITATION.cff cites the paper as the README does."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import yaml

_ROOT = Path(__file__).parents[2]
_VERSION = tomllib.loads((_ROOT / "client/pyproject.toml").read_text())["project"]["version"]
_PROJECT = tomllib.loads((_ROOT / "pyproject.toml").read_text())["project"]


def test_the_version_is_the_same_everywhere() -> None:
    assert f"fastsplat-client=={_VERSION}" in _PROJECT["dependencies"] and "version" in _PROJECT["dynamic"]
    for name, named in (
        ("CHANGELOG.md", r"^## (\S+) \(\d{4}-\d\d-\d\d\)$"),
        ("examples/ros2/fastsplat_interfaces/package.xml", "<version>(.*)</version>"),
        ("examples/ros2/fastsplat_ros2/package.xml", "<version>(.*)</version>"),
        ("examples/ros2/fastsplat_ros2/setup.py", 'version="(.*)"'),
        ("api/web/package.json", '"version": "(.*)"'),
        ("docker/compose.yaml", "IMAGE_VERSION:-(.*)}"),
    ):
        assert re.findall(named, (_ROOT / name).read_text(), re.MULTILINE)[0] == _VERSION, name


def test_the_citation_names_this_release_and_the_readmes_paper() -> None:
    cited = yaml.safe_load((_ROOT / "CITATION.cff").read_text())
    assert (cited["version"], cited["license"]) == (_VERSION, _PROJECT["license"])
    entry = re.search(r"@article\{.*?\n\}", (_ROOT / "README.md").read_text(), re.DOTALL)
    fields = dict(re.findall(r"(\w+)\s*= \{(.*)\},?$", entry[0], re.MULTILINE))
    paper = cited["preferred-citation"]
    assert paper["title"] == re.sub("[{}]", "", fields["title"])
    assert paper["journal"] == fields["journal"] and str(paper["year"]) == fields["year"]
    names = [f"{author['family-names']}, {author['given-names']}" for author in paper["authors"]]
    assert " and ".join(names) == fields["author"]
