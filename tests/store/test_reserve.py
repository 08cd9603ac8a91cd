"""On a disk that is full to the last byte scenes can be deleted; below the floor no upload begins."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from fastsplat.service.store.blobs.reserve import Reserve, check_free_space
from fastsplat.service.store.store import open_store
from fastsplat_contract.errors import DatabaseError, ResourceError
from tests.processes import printed_with_mount

_FULL_DISK = """
import sys
from contextlib import suppress
from pathlib import Path
from fastsplat.service.application.service import open_service
from fastsplat.service.settings import Settings
from fastsplat.service.store.rows.records import NewJob
from fastsplat_contract.errors import DatabaseError

service = open_service(Settings(data_dir=Path(sys.argv[1]) / "data"))
store = service._store
for number in range(3):
    store.scenes.create(NewJob(f"scene{number}", f"op{number}", "desk", "", "d", f"up{number}", {}))
    store.blobs.version(f"scene{number}", "v1").mkdir(parents=True)
    (store.blobs.version(f"scene{number}", "v1") / "large").write_bytes(bytes(4 << 20))
with suppress(OSError), open(Path(sys.argv[1]) / "other", "wb", buffering=0) as other:
    while other.write(bytes(1 << 16)):
        pass
with suppress(OSError), open(Path(sys.argv[1]) / "rest", "wb", buffering=0) as rest:
    while rest.write(bytes(1)):
        pass
try:
    for number in range(1000):
        store.scenes.create(NewJob(f"more{number}", f"more{number}", "desk" * 200, "", "d", "up", {}))
except DatabaseError as error:
    print(error.message)
service.delete_scene("scene0")
print(sorted(store.blobs.ids("scenes")))
store.scenes.create(NewJob("next", "next", "desk", "", "d", "up", {}))
print(service.get_scene("next").state)
"""


def test_a_scene_is_deleted_on_a_full_disk_and_makes_room(tmp_path: Path) -> None:
    printed = printed_with_mount(f"mount -t tmpfs -o size=48m tmpfs {tmp_path}", _FULL_DISK, tmp_path)
    full, left, state = printed.splitlines()
    assert "full" in full and left == "['scene1', 'scene2']" and state == "TRAINING"


def test_the_reserve_is_lent_once_and_made_again(tmp_path: Path) -> None:
    reserve, calls = Reserve(tmp_path), []
    reserve.fill()
    before = (tmp_path / ".reserve").stat().st_size
    assert before >= 1 << 20

    def refuse() -> None:
        calls.append((tmp_path / ".reserve").exists())
        raise DatabaseError("full")

    for _ in range(2):
        with pytest.raises(DatabaseError):
            reserve.lend(refuse)
    assert calls == [True, False, False]
    reserve.fill()
    assert (tmp_path / ".reserve").stat().st_size == before
    assert reserve.lend(lambda: 7) == 7 and (tmp_path / ".reserve").exists()


def test_below_the_floor_no_upload_begins(tmp_path: Path) -> None:
    free = shutil.disk_usage(tmp_path)
    check_free_space(tmp_path, 1)
    check_free_space(tmp_path, 0, 1 << 60)
    with pytest.raises(ResourceError) as caught:
        check_free_space(tmp_path, 1, free.total)
    assert "MIN_FREE_BYTES" in caught.value.limit and caught.value.hint
    if free.free > free.total // 20:  # a floor larger than a small disk's twentieth is that twentieth
        check_free_space(tmp_path, free.total)


def test_a_store_makes_its_reserve(tmp_path: Path) -> None:
    open_store(tmp_path).close()
    assert (tmp_path / ".reserve").exists()
