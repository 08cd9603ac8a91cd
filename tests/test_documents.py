"""What README and DEVELOPMENT name is there: files, make targets, settings, modules to run."""

from __future__ import annotations

import importlib.util
import re
import shlex
from functools import cache
from pathlib import Path

import pytest
from typer.testing import CliRunner

from fastsplat.cli.main import app
from fastsplat.service.settings import Settings

_ROOT = Path(__file__).parent.parent
_DOCUMENTS = ("README.md", "DEVELOPMENT.md")
_MADE = (".venv", ".models/", "api/web/dist/", "demo-output/", "fastsplat-data", "benchmarks/results/")
"""Beginnings of paths that commands make."""
_FOLDERS = ("api", "service", "client", "workers")
_OF_A_PROCESS = {"FASTSPLAT_RASTER_THREADS", "FASTSPLAT_RASTER_ISA", "FASTSPLAT_TEST_DATA"}


@pytest.mark.parametrize("document", _DOCUMENTS)
def test_files_that_a_document_names_exist(document: str) -> None:
    names = set(re.findall(r"(?:`|\]\()([\w.-]+/[\w./-]*|[\w-]+\.(?:md|toml|txt))(?:`|\))", _text(document)))
    paths = {name for name in names if not name.startswith(_MADE) and not _in_an_upload(name)}
    assert len(paths) > 3
    assert sorted(name for name in paths if not _exists(name)) == []


@pytest.mark.parametrize("document", _DOCUMENTS)
def test_make_targets_that_a_document_names_exist(document: str) -> None:
    targets = set(re.findall(r"(?:^|`)make ([a-z-]+)\b", _text(document), re.MULTILINE))
    known = set(re.findall(r"^([a-z-]+):", (_ROOT / "Makefile").read_text(), re.MULTILINE))
    assert targets and targets <= known


@pytest.mark.parametrize("document", _DOCUMENTS)
def test_settings_that_a_document_names_exist(document: str) -> None:
    for name in set(re.findall(r"\bFASTSPLAT_[A-Z0-9_]*[A-Z0-9]\b(?!\*)", _text(document))) - _OF_A_PROCESS:
        group: object = Settings
        for part in name.removeprefix("FASTSPLAT_").rstrip("_").lower().split("__"):
            fields = group.model_fields
            assert part in fields, name
            group = fields[part].annotation


@pytest.mark.parametrize("document", _DOCUMENTS)
def test_modules_that_a_document_runs_exist(document: str) -> None:
    modules = re.findall(r"python -m ([\w.]+)", _text(document))
    assert [name for name in modules if importlib.util.find_spec(name) is None] == []


def test_the_commands_of_the_product_that_the_readme_names_exist() -> None:
    commands = set(re.findall(r"`(?:\.venv/bin/)?fastsplat ([a-z][^`]*)`", _text("README.md")))
    assert len(commands) > 3
    for command in sorted({" ".join(_words(command)) for command in commands}):
        assert CliRunner().invoke(app, [*command.split(), "--help"]).exit_code == 0, command


def _words(command: str) -> list[str]:
    """A command without its arguments and options."""
    words = shlex.split(command.split("[")[0])
    return [word for word in words[:2] if re.fullmatch(r"[a-z-]+", word) and not word.startswith("-")]


@cache
def _text(document: str) -> str:
    return (_ROOT / document).read_text()


def _in_an_upload(name: str) -> bool:
    return name in ("labels/", "sheets/") or "*" in name


def _exists(name: str) -> bool:
    """A path from the root, or, below a folder that was named before it, from anywhere."""
    return (_ROOT / name).exists() or any(any(_ROOT.glob(f"{folder}/**/{name}")) for folder in _FOLDERS)
