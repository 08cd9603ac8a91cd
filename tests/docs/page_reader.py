"""Somebody who follows a page: pastes its blocks, one after the other, into a shell and a Python session."""

from __future__ import annotations

import os
import re
import signal
import subprocess
from contextlib import suppress
from pathlib import Path

from tests.docs.forks import PythonSession
from tests.docs.page_blocks import Block

_HANGS_S = 540
_SCRIPT = r"""
set -aeuo pipefail
_keep() { export -p; declare -f; printf 'cd %q\n' "$PWD"; }
trap '_keep > "$_STATE"; env -0 > "$_STATE.env"' EXIT
if [ -f "$_STATE" ]; then . "$_STATE" > /dev/null; fi
"""


class PageReader:
    """One page's folder with a shell and a Python session that keep state; ports 8000 and 8001 are replaced."""

    def __init__(self, folder: Path, environment: dict[str, str], ports: dict[int, int], programs: Path) -> None:
        self._folder = folder
        self._state = folder.with_name(f"{folder.name}.state")
        self._printed = folder.with_name(f"{folder.name}.printed")
        path = f"{programs}{os.pathsep}{environment['PATH']}"
        self._environment = {**environment, "_STATE": str(self._state), "PATH": path}
        self._ports = ports
        self._groups: list[int] = []
        self._programs = programs
        self._python: PythonSession | None = None

    def run(self, block: Block) -> None:
        """Runs a block; `AssertionError` with where and what it printed if it failed."""
        code = re.sub(r"(localhost|127\.0\.0\.1):(\d+)", self._mapped, block.code)
        if block.language == "sh":
            self._run_in_shell(code, str(block))
        else:
            self._run_in_python(code, str(block))

    def close(self) -> None:
        """End both sessions and what the page left running."""
        if self._python:
            self._python.close()
        for group in self._groups:
            with suppress(ProcessLookupError):
                os.killpg(group, signal.SIGTERM)

    def _run_in_shell(self, code: str, where: str) -> None:
        with self._printed.open("ab") as sink:  # no pipe: what goes on in the background would keep it open
            process = subprocess.Popen(
                ["bash", "-c", _SCRIPT + code],
                cwd=self._folder,
                env=self._environment,
                stdin=subprocess.DEVNULL,
                stdout=sink,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
            self._groups.append(process.pid)
            status = process.wait(_HANGS_S)
        if status:
            raise AssertionError(f"{where} ended with {status}:\n{code}\n{self._last_printed()}")

    def _run_in_python(self, code: str, where: str) -> None:
        if self._python is None:
            with self._printed.open("ab") as sink:
                self._python = PythonSession(self._programs, self._folder, self._environment, sink)
        raised = self._python.run(code, where, self._exported(), _HANGS_S)
        if raised:
            raise AssertionError(f"{where} failed:\n{code}\n{self._last_printed()}\n{raised}")

    def _last_printed(self) -> str:
        return self._printed.read_text(errors="replace")[-4000:]

    def _exported(self) -> dict[str, str]:
        """Variables that the shell has by now."""
        with suppress(FileNotFoundError):
            lines = Path(f"{self._state}.env").read_bytes().split(b"\0")
            return dict(line.decode().split("=", 1) for line in lines if b"=" in line and not line.startswith(b"BASH_"))
        return {}

    def _mapped(self, address: re.Match[str]) -> str:
        host, port = address.group(1), int(address.group(2))
        return f"{host}:{self._ports.get(port, port)}"
