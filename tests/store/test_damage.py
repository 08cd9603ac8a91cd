"""A database with flipped bits answers, or says that it is damaged; nothing else ever comes out."""

from __future__ import annotations

import random
import shutil
import sqlite3
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest
from sqlalchemy import event, text

from fastsplat.service.store.rows.records import NewJob
from fastsplat.service.store.store import open_store
from fastsplat_contract.errors import ArtefactError, DatabaseError, FastSplatError


def _make(folder: Path) -> None:
    store = open_store(folder)
    for number in range(20):
        store.scenes.create(NewJob(f"scene{number}", f"op{number}", "desk", "", "d", "up", {"labels": ["mug"]}))
    store.close()


def _read(folder: Path) -> None:
    store = open_store(folder)
    try:
        store.scenes.list_scenes(100)
        store.scenes.list_operations(100)
        store.jobs.in_turn(99)
        store.jobs.unneeded_uploads(["up"], 0.0)
        store.keys.all()
    finally:
        store.close()


def test_random_flipped_bits_end_in_an_answer_or_a_typed_error(tmp_path: Path) -> None:
    _make(tmp_path / "whole")
    rng = random.Random(3)
    for _ in range(100):
        shutil.rmtree(tmp_path / "copy", ignore_errors=True)
        shutil.copytree(tmp_path / "whole", tmp_path / "copy")
        path = tmp_path / "copy" / "fastsplat.sqlite"
        data = bytearray(path.read_bytes())
        for _ in range(30):
            data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        path.write_bytes(data)
        with suppress(FastSplatError):
            _read(tmp_path / "copy")


@pytest.mark.parametrize("value", ["X'ff7b'", "'{\"labels\": ['"])
def test_a_row_that_is_no_text_or_no_json_is_left_out_of_a_list_and_is_an_error_alone(
    value: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    _make(tmp_path)
    store = open_store(tmp_path)
    with store.engine.begin() as connection:
        connection.execute(text(f"UPDATE operations SET options = {value} WHERE id != 'op7'"))
    for records in (store.scenes.list_operations(5), store.jobs.in_turn(99), store.jobs.queued_in_turn()):
        assert [record.id for record in records] == ["op7"]
    assert "operation op3 is damaged" in caplog.text and store.jobs.claim_next("worker").operation.id == "op7"
    with pytest.raises(ArtefactError, match="damaged"):
        store.scenes.operation("op3")
    assert store.jobs.over(["op3", "op3.1", "op7", "gone"]) == {"gone"}
    store.close()


@pytest.mark.parametrize("offsets", [range(0, 16), range(4096, 8192, 7)], ids=["header", "pages"])
def test_a_damaged_file_is_called_damaged_when_it_is_opened(offsets: range, tmp_path: Path) -> None:
    _make(tmp_path)
    data = bytearray((tmp_path / "fastsplat.sqlite").read_bytes())
    for offset in offsets:
        data[offset] ^= 0x10
    (tmp_path / "fastsplat.sqlite").write_bytes(data)
    with pytest.raises(DatabaseError, match="damaged"):
        _read(tmp_path)


_AS_ANOTHER_USER = """
import os, sys
from pathlib import Path
from fastsplat.service.store.store import open_store
from fastsplat.service.store.care.checkup import check_database, check_folder
from fastsplat_contract.errors import FastSplatError
folder = Path(sys.argv[1])
if os.getuid() == 0:
    os.setgroups([]), os.setgid(65533), os.setuid(65533)
try:
    open_store(folder)
except FastSplatError as error:
    print(error.reason, error.field, error.message)
print([problem.message for problem in (*check_database(folder, ""), *check_folder(folder, 0))])
"""


def test_a_folder_that_cannot_be_written_is_named_and_its_database_is_not_called_damaged(tmp_path: Path) -> None:
    for folder in (tmp_path, *tmp_path.parents[:3]):  # tests that run side by side have a folder more
        folder.chmod(0o755)
    _make(tmp_path / "data")
    for path in (tmp_path / "data").iterdir():
        path.chmod(0o755)
    (tmp_path / "data").chmod(0o555)
    command = [sys.executable, "-P", "-c", _AS_ANOTHER_USER, str(tmp_path / "data")]
    process = subprocess.run(command, check=False, capture_output=True, text=True)
    (tmp_path / "data").chmod(0o755)
    assert process.returncode == 0, process.stderr
    refusal, problems = process.stdout.splitlines()
    assert refusal.startswith("OUT_OF_RESOURCES data_dir the data folder cannot be written")
    assert "cannot be written" in problems and "damaged" not in problems


def test_a_database_on_a_disk_that_turned_read_only_says_so(tmp_path: Path) -> None:
    store = open_store(tmp_path)
    store.engine.dispose()

    @event.listens_for(store.engine, "connect")
    def on_connect(connection: sqlite3.Connection, record: object) -> None:
        connection.execute("PRAGMA query_only=ON")

    with pytest.raises(DatabaseError, match="read-only"):
        store.scenes.create(NewJob("scene", "op", "desk", "", "d", "up", {}))
    assert store.scenes.list_scenes(5) == []
    store.close()
