"""What tests take from npm, in the versions of tests/interop/package-lock.json."""

from __future__ import annotations

import fcntl
import shutil
import subprocess
from pathlib import Path

import pytest

FOLDER = Path(__file__).parent / "interop"


def packages() -> Path:
    """Installs the packages of the lock into `node_modules`; skips the test where Node.js or npm is not here."""
    if shutil.which("npm") is None or shutil.which("node") is None:
        pytest.skip("Node.js with npm is not here, which brings programs and WordNet for tests")
    modules = FOLDER / "node_modules"
    lock = modules / ".package-lock.json"
    with (FOLDER / "package.json").open() as one_at_a_time:
        fcntl.flock(one_at_a_time, fcntl.LOCK_EX)
        if not lock.is_file() or lock.stat().st_mtime < (FOLDER / "package-lock.json").stat().st_mtime:
            subprocess.run(["npm", "ci", "--loglevel=error"], cwd=FOLDER, check=True, capture_output=True, timeout=600)
            lock.touch()
    return modules
