"""An SQLite that knows no fractions of seconds is taught them, as the job engine of Python 3.12 and later asks for."""

from __future__ import annotations

import time
from pathlib import Path

from sqlalchemy import create_engine

from fastsplat.workers.engine import provide_milliseconds


def test_an_old_sqlite_tells_milliseconds(tmp_path: Path) -> None:
    provide_milliseconds((3, 40, 1))
    engine = create_engine(f"sqlite:///{tmp_path / 'a.sqlite'}")
    with engine.begin() as connection:
        connection.exec_driver_sql("CREATE TABLE t (a INT, at INT NOT NULL DEFAULT (unixepoch('subsec') * 1000))")
        before = time.time()
        connection.exec_driver_sql("INSERT INTO t (a) VALUES (1)")
        at = connection.exec_driver_sql("SELECT at FROM t").scalar()
    assert before * 1000 - 1 <= at <= time.time() * 1000 + 1
    engine.dispose()
