"""A database with flipped bits answers, or says that it is damaged; nothing else ever comes out."""

from __future__ import annotations

import random
import shutil
from contextlib import suppress
from pathlib import Path

import pytest
from sqlalchemy import text

from fastsplat.service.store import open_store
from fastsplat.service.store.records import NewJob
from fastsplat_contract.errors import DatabaseError, FastSplatError


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
        store.jobs.waiting()
        store.jobs.uploads(0.0)
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
def test_a_row_that_is_no_text_or_no_json_is_a_damaged_database(value: str, tmp_path: Path) -> None:
    _make(tmp_path)
    store = open_store(tmp_path)
    with store.engine.begin() as connection:
        connection.execute(text(f"UPDATE operations SET options = {value}"))
    with pytest.raises(DatabaseError, match="damaged"):
        store.scenes.list_operations(5)
    store.close()
