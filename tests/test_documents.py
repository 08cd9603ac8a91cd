"""What documents name is there: files, make targets, settings, modules to run, commands with their options, routes."""

from __future__ import annotations

import importlib.util
import json
import re
import shlex
from functools import cache
from typing import Any

import pytest
import typer

from fastsplat.cli.main import app
from fastsplat.service.settings import Settings
from tests.docs.page_blocks import ROOT, blocks_of

_DOCUMENTS = ("README.md", "DEVELOPMENT.md")
_PAGES = tuple(f"docs/{path.name}" for path in sorted((ROOT / "docs").glob("*.md")))
_OUTPUT = (  # beginnings of paths that commands make
    ".venv", ".models/", "api/web/dist/", "build/", "demo-output/", "dist/", "fastsplat-data", "benchmarks/results/",
    "docker/secrets", "site/",
)  # fmt: skip
_FOLDERS = ("api", "service", "client", "workers")
_OF_A_PROCESS = {"FASTSPLAT_RASTER_THREADS", "FASTSPLAT_RASTER_ISA", "FASTSPLAT_TEST_DATA"}
_OF_THE_CLIENT = {"FASTSPLAT_KEY", "FASTSPLAT_SERVER"}


@pytest.mark.parametrize("document", _DOCUMENTS)
def test_files_that_a_document_names_exist(document: str) -> None:
    names = set(re.findall(r"(?:`|\]\()([\w.-]+/[\w./-]*|[\w-]+\.(?:md|toml|txt))(?:`|\))", _text(document)))
    paths = {name for name in names if not name.startswith(_OUTPUT) and name not in ("labels/", "sheets/")}
    assert len(paths) > 3
    assert sorted(name for name in paths if not _exists(name)) == []


@pytest.mark.parametrize("page", _PAGES)
def test_files_of_the_repository_that_a_page_names_exist(page: str) -> None:
    """Pages also name files of uploads and exports, so only paths that begin with a folder of the repository count."""
    folders = "service|api|client|tests|benchmarks|demo|docker|docs|cli|workers|protos|examples"
    paths = {path for path in re.findall(rf"\b((?:{folders})/[\w./-]+\w)", _text(page)) if not path.startswith(_OUTPUT)}
    assert sorted(path for path in paths if not (ROOT / path).exists()) == []


@pytest.mark.parametrize("document", [*_DOCUMENTS, *_PAGES])
def test_make_targets_that_a_document_names_exist(document: str) -> None:
    targets = set(re.findall(r"(?:^|`)make ([a-z-]*[a-z])\b(?![-*])", _text(document), re.MULTILINE))
    known = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    assert targets <= known and (targets or document in _PAGES)


@pytest.mark.parametrize("document", [*_DOCUMENTS, *_PAGES])
def test_settings_that_a_document_names_exist(document: str) -> None:
    names = set(re.findall(r"\bFASTSPLAT_[A-Z0-9_]*[A-Z0-9]\b(?!\*)", _text(document)))
    for prefix, table in re.findall(r"`(FASTSPLAT_\w+__)` before each(.*?)\n#", _text(document), re.DOTALL):
        names |= {
            prefix + name for row in re.findall(r"^\| `[^|]*", table, re.M) for name in re.findall(r"[A-Z_]+", row)
        }
    for name in names - _OF_A_PROCESS - _OF_THE_CLIENT:
        group: object = Settings
        for part in name.removeprefix("FASTSPLAT_").removesuffix("_FILE").rstrip("_").lower().split("__"):
            fields = group.model_fields
            assert part in fields, name
            group = fields[part].annotation


@pytest.mark.parametrize("document", [*_DOCUMENTS, *_PAGES])
def test_modules_that_a_document_runs_exist(document: str) -> None:
    modules = re.findall(r"python -m ([\w.]+)", _text(document))
    assert [name for name in modules if importlib.util.find_spec(name) is None] == []


@pytest.mark.parametrize("document", ["README.md", *_PAGES])
def test_routes_that_a_document_names_exist(document: str) -> None:
    described = json.loads((ROOT / "api" / "rest" / "openapi.json").read_text())["paths"]
    routes = [re.compile(re.sub(r"\\\{[^{}]*\\\}", r"[^/]+", re.escape(route))) for route in described]
    named = set(re.findall(r"(?<![\w.-])/v1/[\w{}$/.:-]*[\w}]", _text(document)))
    assert sorted(path for path in named if not any(route.fullmatch(path) for route in routes)) == []


@pytest.mark.parametrize("document", ["README.md", *_PAGES])
def test_commands_of_the_product_that_a_document_names_exist_with_these_options(document: str) -> None:
    named = re.findall(r"`(?:\.venv/bin/)?fastsplat ([a-z][^`]*)`", " ".join(_text(document).split()))
    for line in named:
        command, _, rest = _command(_words(line), line)
        options = {name for parameter in command.params for name in (*parameter.opts, *parameter.secondary_opts)}
        unknown = {word.partition("=")[0] for word in rest if word.startswith("--")} - options - {"--help"}
        assert not unknown, f"fastsplat {line}"


@pytest.mark.parametrize("document", ["README.md", *_PAGES])
def test_command_lines_of_a_document_are_understood(document: str) -> None:
    for block in blocks_of(ROOT / document):
        lines = block.code.replace("\\\n", " ").splitlines() if block.language == "sh" else []
        for line in lines:
            words = _words(line)
            while words and re.fullmatch(r"[A-Z_]+=.*", words[0]):
                del words[0]
            if not words or words[0].removeprefix(".venv/bin/") != "fastsplat":
                continue
            end = next(
                (place for place, word in enumerate(words) if word in ("|", "||", ">", "&", "&&", ";")), len(words)
            )
            command, name, rest = _command(words[1:end], line)
            try:
                command.make_context(name, ["1" if word.startswith("$") else word for word in rest])
            except Exception as error:  # of typer's own parser, which has no public names
                raise AssertionError(f"{block}: {line}: {error}") from error


def _words(line: str) -> list[str]:
    return shlex.split(line.replace("'", "'" if line.count("'") % 2 == 0 else ""), comments=True)


def _command(words: list[str], line: str) -> tuple[Any, str, list[str]]:
    """The command that the first words name, its name, and the other words."""
    command, name = _program(), "fastsplat"
    while words and isinstance(subcommands := getattr(command, "commands", None), dict):
        if words[0].startswith("-"):
            break
        assert words[0] in subcommands, f"fastsplat {line}"
        name, *words = words
        command = subcommands[name]
    return command, name, words


@cache
def _program() -> Any:
    return typer.main.get_command(app)


@cache
def _text(document: str) -> str:
    return (ROOT / document).read_text()


def _exists(name: str) -> bool:
    """A path from the root, or, below a folder that was named before it, from anywhere."""
    return (ROOT / name).exists() or any(any(ROOT.glob(f"{folder}/**/{name}")) for folder in _FOLDERS)
