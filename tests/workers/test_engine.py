"""What a worker relies on in the job engine, and how it opens the engine's database."""

from __future__ import annotations

import ast
import inspect
import time
from pathlib import Path

import pytest
from dbos import DBOS
from dbos._utils import retriable_postgres_exception
from sqlalchemy import make_url
from sqlalchemy.exc import OperationalError

from fastsplat.workers import engine
from fastsplat.workers.engine import open_database

_ROOT = Path(__file__).parents[2]


def _names_of_dbos(path: Path) -> set[str]:
    """What a file imports from the engine's package, and the attributes of those that it names."""
    tree = ast.parse(path.read_text())
    imports = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom | ast.Import)]
    modules = [alias.name for node in imports if isinstance(node, ast.Import) for alias in node.names]
    found = {name for name in modules if name.partition(".")[0] == "dbos"}
    for node in imports:
        if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] == "dbos":
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    owners = {name.rpartition(".")[2] for name in found}
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in owners:
            found.add(f"{node.value.id}.{node.attr}")
    return found


def test_one_file_knows_the_engine_and_one_name_of_it_is_not_public() -> None:
    folders = ("api", "cli", "client", "service", "workers")
    named = {path: _names_of_dbos(path) for folder in folders for path in (_ROOT / folder).rglob("*.py")}
    assert [path for path, names in named.items() if names] == [Path(engine.__file__).resolve()]
    (names,) = filter(None, named.values())
    assert {name for name in names if "._" in name} == {"DBOS._recover_pending_workflows"}


def test_the_engine_has_the_internal_method_that_recovers_a_dead_executors_jobs() -> None:
    assert list(inspect.signature(DBOS._recover_pending_workflows).parameters) == ["executor_ids"]


@pytest.mark.parametrize("address", ["@:5432/a?host=/nowhere", "@name.invalid:5432/a", "@127.0.0.1:1/a"])
def test_the_engine_tries_again_when_the_database_cannot_be_reached(address: str) -> None:
    database = open_database(make_url(f"postgresql+psycopg://user{address}"), (3, 45))
    with pytest.raises(OperationalError) as caught:
        database.connect()
    assert retriable_postgres_exception(caught.value)


def test_an_sqlite_that_knows_no_fractions_of_seconds_is_taught_them(tmp_path: Path) -> None:
    """The job engine of Python 3.12 and later asks for them."""
    database = open_database(make_url(f"sqlite:///{tmp_path / 'a.sqlite'}"), (3, 40, 1))
    with database.begin() as connection:
        connection.exec_driver_sql("CREATE TABLE t (a INT, at INT NOT NULL DEFAULT (unixepoch('subsec') * 1000))")
        before = time.time()
        connection.exec_driver_sql("INSERT INTO t (a) VALUES (1)")
        at = connection.exec_driver_sql("SELECT at FROM t").scalar()
    assert before * 1000 - 1 <= at <= time.time() * 1000 + 1
    database.dispose()
