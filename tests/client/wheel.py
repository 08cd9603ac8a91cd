"""The client's wheel, built once and put into virtual environments of their own."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def build_wheel(folder: Path) -> Path:
    _run([sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", folder, ROOT / "client"])
    (wheel,) = folder.glob("*.whl")
    return wheel


def make_environment(python: str | Path, folder: Path, *requirements: str | Path, pip: bool = True) -> Path:
    """Makes a virtual environment with these installed; without `pip`, this one's pip installs them uncompiled."""
    _run([python, "-m", "venv", folder] if pip else [python, "-m", "venv", "--without-pip", folder])
    executable = folder / "bin" / "python"
    options = ["--quiet", "--disable-pip-version-check"]
    if requirements and pip:
        _run([executable, "-m", "pip", "install", *options, *requirements])
    elif requirements:
        _run([sys.executable, "-m", "pip", "--python", executable, "install", *options, "--no-compile", *requirements])
    return executable


def interpreter(version: str) -> Path | None:
    """A Python of this version ("3.10"): of the path, or of pyenv."""
    named = shutil.which(f"python{version}")
    choices = [Path(named)] if named else []
    choices += sorted((Path.home() / ".pyenv" / "versions").glob(f"{version}.*/bin/python{version}"))
    for python in choices:
        reply = subprocess.run([python, "-c", "import sys; print(*sys.version_info[:2], sep='.')"], capture_output=True)
        if reply.stdout.decode().strip() == version:
            return python
    return None


def _run(command: list[str | Path]) -> None:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
