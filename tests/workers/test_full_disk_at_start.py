"""A worker that starts on a full disk waits for space, where it would otherwise end and be given up."""

from __future__ import annotations

import shutil
from pathlib import Path
from types import SimpleNamespace

import pytest

from fastsplat.workers.worker_process import wait_for_space


def test_a_worker_waits_for_space_and_stops_waiting_when_it_is_to_stop(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    free, pauses = [0, 4096, 1 << 30, 0, 0], [False, False, True]
    monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=free.pop(0)))
    wait_for_space(tmp_path, lambda seconds: pauses.pop(0))
    assert (len(free), len(pauses)) == (2, 1)
    wait_for_space(tmp_path, lambda seconds: pauses.pop(0))
    assert (len(free), len(pauses)) == (1, 0)
    wait_for_space(tmp_path / "not there yet", lambda seconds: True)
    assert len(free) == 1
