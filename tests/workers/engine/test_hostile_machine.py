"""On a read-only disk every call ends in an answer or a typed error."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from types import SimpleNamespace

import pytest

from fastsplat.service.store.rows.records import NewJob
from fastsplat.service.store.store import open_store
from fastsplat.workers.engine.worker import wait_for_space
from tests.processes import printed_with_mount

_READ_ONLY = """
import sys
from pathlib import Path
from fastsplat.service.application.service import open_service
from fastsplat.service.settings import Settings
from fastsplat_contract.errors import FastSplatError
settings = Settings(data_dir=Path(sys.argv[1]))
def ended(call):
    try:
        call()
        return "answered"
    except FastSplatError as error:
        return error.reason
service = None
def start():
    global service
    service = open_service(settings)
print(ended(start))
if service is not None:
    for call in (service.list_scenes, lambda: service.get_scene("scene"), lambda: service.new_upload(),
                 lambda: service.resumable.create("k", "a.zip", 10), lambda: service.delete_scene("scene"),
                 lambda: service.cancel_operation("op"), service.admin.check_ready):
        print(ended(call))
"""


def test_on_a_read_only_disk_every_call_ends_in_an_answer_or_a_typed_error(tmp_path: Path) -> None:
    data = tmp_path / "data"
    store = open_store(data)
    store.scenes.create(NewJob("scene", "op", "desk", "", "d", "up", {}))
    store.close()
    mount = f"mount --bind {data} {data} && mount -o remount,ro,bind {data}"
    reasons = printed_with_mount(mount, _READ_ONLY, data).split()
    assert reasons and all(re.fullmatch(r"answered|[A-Z_]+", reason) for reason in reasons)
    assert reasons[0] != "answered" or reasons[3:] == [
        *("OUT_OF_RESOURCES", "OUT_OF_RESOURCES", "DATABASE_UNAVAILABLE", "DATABASE_UNAVAILABLE", "OUT_OF_RESOURCES")
    ]


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
