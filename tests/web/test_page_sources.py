"""The page's own checks, and what its lock file and its built files must not say."""

from __future__ import annotations

import gzip
import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from fastsplat.api.rest.page import BUILT_PAGE

_SOURCES = Path(__file__).parents[2] / "api/web"
_FIRST_LOAD_BYTES = 1_500_000


@pytest.fixture(scope="module")
def npm() -> str:
    """The program, where it and the page's packages are."""
    program = shutil.which("npm")
    if program is None or not (_SOURCES / "node_modules").is_dir():
        pytest.skip("no Node.js in this machine, or its packages are not installed: make page")
    return program


def test_types_lint_format_and_unit_tests_hold(npm: str) -> None:
    done = subprocess.run([npm, "run", "--silent", "check"], cwd=_SOURCES, capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-2000:]


def test_the_lock_file_names_no_registry() -> None:
    lock = json.loads((_SOURCES / "package-lock.json").read_text())
    assert not [name for name, package in lock["packages"].items() if "resolved" in package]
    assert all("integrity" in package for name, package in lock["packages"].items() if name)


@pytest.fixture(scope="module")
def built() -> Path:
    """The folder of the built page."""
    if not (BUILT_PAGE / "index.html").is_file():
        pytest.skip("the page is not built: make page")
    return BUILT_PAGE


def test_every_address_of_the_built_page_is_relative(built: Path) -> None:
    html = (built / "index.html").read_text()
    addresses = re.findall(r"""(?:href|src)="([^"#]+)\"""", html)
    assert len(addresses) >= 4
    for address in addresses:
        assert not re.match(r"/|\w+:", address), address
        assert address == "docs" or (built / address.removeprefix("web/")).is_file(), address
    assert "<style" not in html and not re.search(r"<script(?![^>]*\ssrc=)", html)


def test_the_licenses_of_what_is_bundled_come_along(built: Path) -> None:
    text = (built / "licenses.txt").read_text()
    for name in ("playcanvas", "preact", "@preact/signals"):
        assert re.search(rf"^{re.escape(name)} \S+ \(MIT\)$", text, re.MULTILINE), name


def test_the_first_load_is_small(built: Path) -> None:
    files = [path for path in built.rglob("*") if path.suffix in {".html", ".js", ".css", ".svg"}]
    files.remove(built / "offline.html")  # a part of files that are taken away
    assert sum(len(gzip.compress(path.read_bytes())) for path in files) <= _FIRST_LOAD_BYTES
