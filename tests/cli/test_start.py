"""A service that starts: its data is its owner's alone, and its log says which protections this machine lacks."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

_START = """
import sys
from pathlib import Path
import fastsplat.service.capture.untrusted.confinement as confinement
confinement.missing_protections = lambda: tuple(sys.argv[2:])
from fastsplat.cli.main import _start
from fastsplat.service.store.store import open_store
_start("api")
store = open_store(Path(sys.argv[1]))
store.blobs.upload("one").mkdir(parents=True)
(store.blobs.upload("one") / "photo.jpg").write_bytes(b"home")
"""


@pytest.mark.parametrize("missing", [(), ("Landlock (files): not there", "seccomp (system calls): forbidden")])
def test_nobody_else_reads_the_data_and_the_log_says_what_is_missing(tmp_path: Path, missing: tuple[str, ...]) -> None:
    data = tmp_path / "data"
    started = subprocess.run(
        [sys.executable, "-c", _START, str(data), *missing], check=True, capture_output=True, text=True
    )
    messages = [json.loads(line)["message"] for line in started.stderr.splitlines()]
    assert [line for line in messages if "without protection" in line] == [
        f"parsers of uploads run without protection: {name}" for name in missing
    ]
    paths = [data, *data.rglob("*")]
    assert len(paths) > 3 and not any(path.stat().st_mode & 0o077 for path in paths)
