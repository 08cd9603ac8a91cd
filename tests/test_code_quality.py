"""Rules for all code: lint, format, types, import contracts, length of files, names of modules and parameters."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
_MAX_LINES = 600
_MAX_FILES = {True: 25, False: 20}  # of tests, of all else
_PRODUCT = ("api", "cli", "client", "demo", "service", "workers")

_VAGUE_PARAMETERS = {"found", "wanted", "given", "chosen"}

_OLD_WORDS = {
    "thing": "object", "namer": "captioner", "standing_question": "subscription", "object_sheet": "contact sheet",
}  # fmt: skip
_EMPTY_WORDS = {"each", "own", "other", "others", "one", "ones", "shown", "told", "asked", "kept", "made"}
"""Nothing is called by such a word alone."""
_FOUND_BY = {
    "change detection": "service/localization/changes.py",
    "instance segmentation": "service/instances/scene_objects.py",
    "pnp": "service/localization/pose_solving.py",
    "redact": "service/perception/label_maps/movers.py",
    "visual localization": "service/localization/photo_placement.py",
}

_SPELLINGS = {re.compile(r'(?<!")metre|metre(?!s?")', re.IGNORECASE): "meter"}
"""Spellings, and the one that is used here. In quotes, files for other programs may hold the other one as a value."""
_WORDS_OF_PEOPLE = Path("service/query/language/meaning/common_objects.txt")


@pytest.mark.parametrize(
    "command",
    [("ruff", "check", "."), ("ruff", "format", "--check", "."), ("mypy",), ("lint-imports",)],
    ids=lambda command: " ".join(command),
)
def test_tool_has_no_complaint(command: tuple[str, ...]) -> None:
    tool = Path(sys.executable).parent / command[0]
    result = subprocess.run([tool, *command[1:]], cwd=ROOT, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout + result.stderr


def test_files_are_short() -> None:
    sources = [
        path for path in _tracked() if path.suffix in (".py", ".cpp", ".h", ".js", ".ts", ".tsx", ".css", ".html")
    ]
    lines = {str(path): (ROOT / path).read_text().count("\n") for path in sources}
    assert lines
    assert not {name: count for name, count in lines.items() if count > _MAX_LINES}


def test_folders_are_small() -> None:
    counts = Counter(path.parent for path in _tracked() if path.suffix == ".py" and path.name != "__init__.py")
    assert not {str(path): n for path, n in counts.items() if n > _MAX_FILES[path.parts[0] == "tests"]}


def test_parameters_say_what_they_are() -> None:
    product = [path for path in _tracked() if path.suffix == ".py" and path.parts[0] in _PRODUCT]
    vague = {str(path) for path in product if _parameters(path) & _VAGUE_PARAMETERS}
    assert not vague


def test_a_word_has_one_spelling() -> None:
    texts = {
        path: _text(path) for path in _tracked() if path not in (_WORDS_OF_PEOPLE, Path("tests") / Path(__file__).name)
    }
    faults = {str(path): word for path, text in texts.items() for old, word in _SPELLINGS.items() if old.search(text)}
    assert not faults


def test_no_name_has_a_word_of_our_own_where_the_field_has_one() -> None:
    """In files' names, in Python and on the wire; the field's words are listed in docs/words.md."""
    proto = Path("protos/fastsplat/v1/fastsplat.proto")
    names = {(name, proto) for name in re.findall(r"\w+", re.sub(r"//.*", "", _text(proto)))}
    for path in (path for path in _tracked() if path.suffix == ".py"):
        names.add((path.stem, path))
        for node in ast.walk(ast.parse(_text(path))):
            found = [getattr(node, field, None) for field in ("name", "arg", "id", "attr")]
            names |= {(name, path) for name in found if isinstance(name, str)}
            if not isinstance(node, ast.keyword) and not isinstance(getattr(node, "ctx", None), ast.Load):
                assert not _EMPTY_WORDS & {str(name).strip("_").lower() for name in found}, f"{path}:{node.lineno}"
    assert len(names) > 40_000
    for name, path in names:
        words = "_".join(word.lower().removesuffix("s") for word in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", name))
        for old, word in _OLD_WORDS.items():
            assert f"_{old}_" not in f"_{words}_", f"{path}: {name}; the field says {word}"


def test_only_benchmarks_tests_know_benchmarks() -> None:
    sources = [path for path in _tracked() if path.suffix == ".py" and "benchmarks" not in path.parts[:2]]
    assert not [path for path in sources if re.search(r"^\s*(from|import) benchmarks\b", _text(path), re.MULTILINE)]


def test_cpp_is_formatted_and_fits_into_120_columns() -> None:
    sources = sorted(ROOT / path for path in _tracked() if path.suffix in (".cpp", ".h"))
    assert sources
    tool = Path(sys.executable).parent / "clang-format"
    result = subprocess.run(
        [tool, "--dry-run", "-Werror", *sources], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stderr
    lines = [(path.name, n, line) for path in sources for n, line in enumerate(path.read_text().splitlines(), 1)]
    assert not [f"{name}:{n}" for name, n, line in lines if len(line) > 120]


def test_the_stub_of_the_extension_is_what_the_extension_says(tmp_path: Path) -> None:
    """Otherwise `make stubs` writes it anew."""
    stub = tmp_path / "_cpu.pyi"
    module = "fastsplat.service.splatting.raster._cpu"
    bin_dir = Path(sys.executable).parent
    for command in (
        (sys.executable, "-m", "nanobind.stubgen", "-q", "-m", module, "-o", stub),
        (bin_dir / "ruff", "format", "-q", "--config", ROOT / "pyproject.toml", stub),
    ):
        result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
        assert result.returncode == 0, result.stdout + result.stderr
    assert stub.read_text() == (ROOT / "service/splatting/raster/_cpu.pyi").read_text()


def _tracked() -> Iterator[Path]:
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    paths = map(Path, listed.split("\n")[:-1])
    return (path for path in paths if "_pb2" not in path.name and (ROOT / path).is_file())


def _text(path: Path) -> str:
    """What a file says; nothing of one that is no text."""
    data = (ROOT / path).read_bytes()
    return "" if b"\0" in data else data.decode(errors="replace")


def _parameters(path: Path) -> set[str]:
    functions = (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)
    nodes = [node.args for node in ast.walk(ast.parse((ROOT / path).read_text())) if isinstance(node, functions)]
    return {argument.arg for node in nodes for argument in (*node.posonlyargs, *node.args, *node.kwonlyargs)}
