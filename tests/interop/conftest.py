"""Programs that are not ours, from npm, in the versions of package-lock.json."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.npm import packages

HERE = Path(__file__).parent
_VALIDATE = """
import { readFileSync } from "node:fs";
import validator from "gltf-validator";
const report = await validator.validateBytes(new Uint8Array(readFileSync(process.argv[1])), { maxIssues: 0 });
console.log(JSON.stringify({ messages: report.issues.messages, info: report.info }));
"""


@pytest.fixture(scope="session")
def node() -> Callable[..., str]:
    """Runs Node.js in this folder, with what its package-lock.json names installed; returns what it prints."""
    packages()

    def run(*arguments: str | Path) -> str:
        command = ["node", *map(str, arguments)]
        done = subprocess.run(command, cwd=HERE, check=False, capture_output=True, text=True, timeout=300)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    return run


@pytest.fixture(scope="session")
def splat_transform(node: Callable[..., str]) -> Callable[..., None]:
    """PlayCanvas' splat-transform, without a GPU."""
    program = HERE / "node_modules" / "@playcanvas" / "splat-transform" / "bin" / "cli.mjs"

    def run(*arguments: str | Path) -> None:
        node(program, "-q", "-w", *arguments)

    return run


@pytest.fixture(scope="session")
def gltf_report(node: Callable[..., str]) -> Callable[[Path], Any]:
    """What the Khronos glTF validator says of a file: its messages, and its figures as `info`."""

    def report(path: Path) -> Any:
        return json.loads(node("--input-type=module", "-e", _VALIDATE, path))

    return report
