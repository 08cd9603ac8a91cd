"""The contract and the client need no more than they say."""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

_CLIENT = Path(__file__).resolve().parents[2] / "client"
_CONTRACT_NEEDS = {"numpy", "pydantic", "pydantic_core", "google.protobuf", "fastsplat_contract"}
_NEEDS = {
    "fastsplat_contract": _CONTRACT_NEEDS,
    "fastsplat_contract/v1": {"google.protobuf", "grpc", "fastsplat_contract"},
    "fastsplat_client": _CONTRACT_NEEDS | {"httpx", "grpc", "fastsplat_client"},
}


def _imported(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom):
            yield str(node.module)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)


@pytest.mark.parametrize("package", _NEEDS)
def test_a_package_imports_only_what_it_declares(package: str) -> None:
    sources = list((_CLIENT / package).glob("*.py"))
    assert sources
    for path in sources:
        for name in _imported(path):
            known = any(f"{name}.".startswith(f"{need}.") for need in _NEEDS[package])
            assert known or name.partition(".")[0] in sys.stdlib_module_names, f"{path.name} imports {name}"
