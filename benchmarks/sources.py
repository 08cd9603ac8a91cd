"""Which sources a benchmark runs, and how many of them have changed in meaning since it was measured.

Sources are the project's modules that are reached from a benchmark's by import or by a name in quotes (of a process
that it starts), data and C++ beside them included. Comments, docstrings, layout and the place of a module have no
meaning. Nothing is asked of git, so that a clone without history says the same.
"""

from __future__ import annotations

import ast
import hashlib
import re
from base64 import urlsafe_b64encode
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]

_MODULE = re.compile(r"(?:benchmarks|demo|tests|fastsplat(?:_contract|_client)?)(?:\.\w+)+")
_COMMENT = re.compile(r"//.*?$|/\*.*?\*/", re.MULTILINE | re.DOTALL)
_DATA, _CPP = (".json", ".toml", ".txt"), (".cpp", ".h", ".cmake")


@cache
def sources_of(module: str, root: Path = ROOT) -> str:
    """A digest of five letters for each source of a module, sorted, with blanks between; "" where it is no module."""
    found: dict[Path, str] = {}
    names = [module]
    while names:
        path = _file(names.pop(), root)
        if path is not None and path not in found:
            found[path], named = _read(path)
            names += named
    folders = {path.parent for path in found}
    beside = [path for folder in folders for path in folder.iterdir() if path.suffix in _DATA]
    beside += [path for folder in folders for path in (folder / "cpp").rglob("*") if path.suffix in _CPP]
    texts = (_COMMENT.sub("", path.read_text()) if path.suffix in _CPP else path.read_text() for path in beside)
    return " ".join(sorted({*found.values(), *(_digest("".join(text.split())) for text in texts)}))


def changes_since(run: Mapping[str, Any], module: str, root: Path = ROOT) -> str:
    """How many sources of a module differ from those that a row of results was measured with, in words."""
    if not run.get("sources"):
        return "its sources were not recorded"
    now = sources_of(module, root).split()
    changed = set(now) - set(run["sources"].split())
    return f"since then {len(changed)} of {len(now)} sources changed" if changed else "its sources are today's"


def module_of(name: str, text: str, root: Path = ROOT) -> str:
    """The module that wrote the results `name`.json of this content, by the name it has today."""
    named = re.findall(r"python -m (benchmarks\.[\w.]+)", text)
    return next((module for module in named if _file(module, root)), f"benchmarks.{name}")


@cache
def _file(module: str, root: Path) -> Path | None:
    """The source of a module, a package's `__main__` before its `__init__`, which says nothing here."""
    ends = (".py", ".pyi", "/__main__.py", "/__init__.py")
    tried = (base / f"{module.replace('.', '/')}{end}" for base in (root, root / "client") for end in ends)
    return next((path.resolve() for path in tried if path.is_file()), None)


@cache
def _read(path: Path) -> tuple[str, frozenset[str]]:
    """The digest of a module, and the modules that it names."""
    tree = ast.parse(path.read_bytes())
    return _digest(repr(_meaning(tree))), frozenset(_named(tree))


def _named(tree: ast.Module) -> Iterator[str]:
    """Modules that may be meant by a module's imports and strings."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield from (node.module, *(f"{node.module}.{alias.name}" for alias in node.names))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and _MODULE.fullmatch(node.value):
            yield node.value


def _meaning(node: Any) -> Any:
    """The syntax tree without docstrings, and without the folders that names are imported from.

    `ast.dump` differs between versions of Python in what it leaves out where it is empty.
    """
    if isinstance(node, list):
        return [_meaning(item) for item in node]
    if not isinstance(node, ast.AST):
        return node
    fields = {name: value for name, value in ast.iter_fields(node) if value not in (None, [])}
    if isinstance(node, ast.ImportFrom):
        fields.pop("module", None)
    statements = fields.get("body", ())
    if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
        fields["body"] = [item for item in statements if not _is_text(item)]
    return [type(node).__name__, *((name, _meaning(value)) for name, value in fields.items())]


def _is_text(statement: ast.stmt) -> bool:
    """A string as a statement: a docstring, also of a field or constant, as the line above it."""
    value = statement.value if isinstance(statement, ast.Expr) else None
    return isinstance(value, ast.Constant) and isinstance(value.value, str)


def _digest(text: str) -> str:
    return urlsafe_b64encode(hashlib.sha256(text.encode()).digest())[:5].decode()
