"""Copies of the sources in which a test changes files."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
_RASTERIZER = "fastsplat.service.splatting.raster._cpu"
_WITHOUT_EDITABLE = """import sys

sys.meta_path[:] = [finder for finder in sys.meta_path if not type(finder).__module__.startswith("_editable")]
"""  # its finder would import `fastsplat` from the repository


def copy_sources(target: Path, *folders: str) -> Path:
    """Copies folders of the repository, and links all others."""
    for path in ROOT.iterdir():
        if path.name in ("fastsplat", *folders):  # `fastsplat` has links to the folders beside it
            shutil.copytree(path, target / path.name, symlinks=True, ignore=shutil.ignore_patterns("web"))
        elif not path.name.startswith("."):
            (target / path.name).symlink_to(path)
    if "api" in folders:
        (target / "api/web").symlink_to(ROOT / "api/web")
    extension = importlib.util.find_spec(_RASTERIZER)
    if "service" in folders and extension is not None and extension.origin is not None:
        (target / "service/splatting/raster" / Path(extension.origin).name).symlink_to(extension.origin)
    (target / "sitecustomize.py").write_text(_WITHOUT_EDITABLE)
    return target


def insert(path: Path, anchor: str, text: str) -> None:
    """Inserts text after an anchor that a file has once: lines, if a line ends there. Without one, at the end."""
    old = path.read_text() if path.exists() else ""
    before, _, after = old.partition(anchor) if anchor else (old, "", "")
    assert not anchor or old.count(anchor) == 1, f"{path} has {old.count(anchor)} times {anchor}"
    text = f"\n{text.removesuffix(chr(10))}" if not after or after.startswith("\n") else text.removesuffix("\n")
    path.write_text(f"{before}{anchor}{text}{after or chr(10)}")


def run_python(root: Path, *arguments: str) -> str:
    """Runs Python on the copy, and returns its output; a failure fails the test."""
    environment = {**os.environ, "PYTHONPATH": f"{root}:{root / 'client'}"}
    command = [sys.executable, *arguments]
    done = subprocess.run(command, cwd=root, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-8000:] + done.stderr[-4000:]
    return done.stdout
