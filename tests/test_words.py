"""Names of files, classes, functions, parameters and the wire are the field's words, which DEVELOPMENT.md lists."""

from __future__ import annotations

import ast
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

_ROOT = Path(__file__).parent.parent
_RETIRED = {
    "thing": "object",
    "namer": "captioner",
    "standing_question": "subscription",
    "object_sheet": "contact sheet",
}
_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+")


def _names(path: Path) -> Iterator[str]:
    yield path.stem
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, (ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)):
            yield node.name
        elif isinstance(node, ast.arg):
            yield node.arg
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            yield node.target.id


def test_no_name_has_a_word_of_our_own_where_the_field_has_one() -> None:
    listed = subprocess.run(["git", "ls-files", "*.py"], cwd=_ROOT, capture_output=True, text=True, check=True)
    paths = [_ROOT / name for name in listed.stdout.split() if "_pb2" not in name]
    names = {(name, path) for path in paths for name in _names(path)}
    proto = _ROOT / "protos" / "fastsplat" / "v1" / "fastsplat.proto"
    declared = re.sub(r"//.*", "", proto.read_text())
    names |= {(name, proto) for name in re.findall(r"\w+", declared)}
    assert len(names) > 20_000
    for name, path in names:
        words = "_".join(word.lower().removesuffix("s") for word in _WORD.findall(name))
        found = [retired for retired in _RETIRED if f"_{retired}_" in f"_{words}_"]
        assert not found, f"{path}: {name}; the field says {_RETIRED[found[0]]}"
