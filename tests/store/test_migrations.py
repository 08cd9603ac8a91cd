"""Migrations: a database of an earlier release becomes this release's, with everything in it; none goes back."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, nullcontext
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from alembic.autogenerate import compare_metadata
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import Engine, create_engine, inspect, text

from fastsplat.service.store.care.backup import restore
from fastsplat.service.store.care.checkup import check_database
from fastsplat.service.store.repositories.key_repository import KeyRecord
from fastsplat.service.store.rows.before_upgrade import save_before_upgrade
from fastsplat.service.store.rows.database import open_engine, resolve_url
from fastsplat.service.store.rows.migrations import migrate
from fastsplat.service.store.rows.schema import metadata
from fastsplat.service.store.store import open_store
from fastsplat_contract.errors import ConflictError, ResourceError
from tests.postgres import PostgresServer
from tests.scenes import queued_job

_SCRIPTS = Path(sys.modules[migrate.__module__].__file__ or "").parent
_NOTE = "op.execute(\"UPDATE scenes SET name = name || '{}'\")".format


@pytest.fixture
def stored(tmp_path: Path, database_url: str) -> Iterator[Engine]:
    """A database of this release with a scene "desk", whose job waits, and a key."""
    with closing(open_store(tmp_path, database_url)) as store:
        store.scenes.create(queued_job("desk"))
        store.keys.add(KeyRecord("0" * 12, "robot", "reader", "0" * 64, 0.0))
        yield store.engine


def _shape(engine: Engine) -> dict[str, Any]:
    """Everything that a schema promises."""
    tables = inspect(engine)
    return {
        name: (
            {c["name"]: (repr(c["type"]), c["nullable"]) for c in tables.get_columns(name)},
            tables.get_pk_constraint(name)["constrained_columns"],
            sorted(tuple(i["column_names"]) for i in tables.get_indexes(name)),
            sorted(tuple(u["column_names"]) for u in tables.get_unique_constraints(name)),
        )
        for name in tables.get_table_names()
        if name != "alembic_version"
    }


def _rows(engine: Engine) -> dict[str, list[str]]:
    """All rows, whichever database holds them: SQLite's booleans are numbers, and its JSON is text."""

    def plain(value: Any) -> Any:
        written = isinstance(value, str) and (value[:1] in ("{", "[") or value == "null")
        return json.loads(value) if written else int(value) if isinstance(value, bool) else value

    with engine.connect() as connection:
        found = {
            name: connection.execute(text(f"SELECT * FROM {name}")).mappings()
            for name in inspect(connection).get_table_names()
        }
        return {
            name: sorted(repr({key: plain(row[key]) for key in sorted(row)}) for row in rows)
            for name, rows in found.items()
        }


def test_a_new_database_is_the_same_as_the_tables(tmp_path: Path, database_url: str) -> None:
    engine = open_engine(resolve_url(tmp_path, database_url))
    migrated = _shape(engine)
    with engine.begin() as connection:
        assert compare_metadata(MigrationContext.configure(connection), metadata) == []
        metadata.drop_all(connection)
        metadata.create_all(connection)
    assert _shape(engine) == migrated
    engine.dispose()


def test_an_upgrade_by_many_at_once_happens_once(
    stored: Engine, later: Callable[..., Path], tmp_path: Path, database_url: str
) -> None:
    scripts, barrier = later(_NOTE(1)), threading.Barrier(6)

    def upgrade(_: int) -> None:
        with closing(open_store(tmp_path, database_url)) as store:
            barrier.wait()
            migrate(store.engine, scripts)

    with ThreadPoolExecutor(6) as pool:
        list(pool.map(upgrade, range(6)))
    with stored.connect() as connection:
        assert connection.scalars(text("SELECT name FROM scenes")).all() == ["desk1"]
        assert connection.scalar(text("SELECT count(*) FROM alembic_version")) == 1


_OPEN = """
import sys
from pathlib import Path
from fastsplat.service.store.store import open_store
print("ready", flush=True)
sys.stdin.readline()
store = open_store(Path(sys.argv[1]), sys.argv[2])
print(len(store.projects.names()))
"""


def test_processes_that_start_at_once_make_the_tables_once(tmp_path: Path, database_url: str) -> None:
    command = [sys.executable, "-c", _OPEN, str(tmp_path), database_url]
    pipe = subprocess.PIPE
    processes = [subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) for _ in range(3)]
    for process in processes:
        assert process.stdout.readline() == "ready\n"
    for process in processes:
        process.stdin.write("go\n")
        process.stdin.flush()
    assert [process.communicate()[0] for process in processes] == ["1\n"] * 3
    with closing(open_store(tmp_path, database_url)) as store, store.engine.connect() as connection:
        for table in ("alembic_version", "identity"):
            assert connection.scalar(text(f"SELECT count(*) FROM {table}")) == 1


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (["UPDATE alembic_version SET version_num = '1000'"], ("version 1000", "a newer one")),
        (["UPDATE alembic_version SET version_num = '0002'"], ("before the first release", "import")),
        (["DROP TABLE alembic_version"], ("before the first release", "import")),
    ],
)
def test_a_database_that_this_release_does_not_read_is_refused_unchanged(
    changes: list[str], words: tuple[str, str], stored: Engine, tmp_path: Path, database_url: str
) -> None:
    with stored.begin() as connection:
        for statement in changes:
            connection.execute(text(statement))
    before = _shape(stored), _rows(stored)
    with pytest.raises(ConflictError, match=words[0]) as caught:
        open_store(tmp_path, database_url)
    assert words[1] in caught.value.hint and caught.value.field == "database_url"
    (problem,) = check_database(tmp_path, database_url)
    assert (problem.message, problem.hint, problem.mendable) == (caught.value.message, caught.value.hint, False)
    assert (_shape(stored), _rows(stored)) == before


@pytest.fixture
def later(tmp_path: Path) -> Callable[..., Path]:
    """Makes an alembic folder with more revisions than the product's: the bodies of their `upgrade`."""

    def make(*bodies: str) -> Path:
        folder = tmp_path / f"migrations{len(bodies)}"
        shutil.copytree(_SCRIPTS, folder, dirs_exist_ok=True)
        for number, body in enumerate(bodies, start=len(_revisions()) + 3):
            lines = (
                "import sqlalchemy as sa", "from alembic import op",
                f"revision, down_revision = '{number:04}', '{number - 1:04}'", f"def upgrade(): {body}",
            )  # fmt: skip
            (folder / "versions" / f"v{number:04}_test.py").write_text("\n".join(lines))
        return folder

    return make


def _revisions() -> list[Any]:
    config = Config()
    config.set_main_option("script_location", str(_SCRIPTS))
    return list(ScriptDirectory.from_config(config).walk_revisions())[::-1]


def test_file_names_bear_the_revisions_in_one_line() -> None:
    revisions = _revisions()
    assert [revision.revision for revision in revisions] == [f"{n:04}" for n in range(3, len(revisions) + 3)]
    assert [Path(revision.path).name[1:5] for revision in revisions] == [revision.revision for revision in revisions]


def test_a_migration_that_fails_leaves_the_database_as_it_was(stored: Engine, later: Callable[..., Path]) -> None:
    before = _shape(stored), _rows(stored)
    bad = later("op.add_column('scenes', sa.Column('half', sa.Integer)); raise RuntimeError('a defect')")
    with pytest.raises(RuntimeError, match="a defect"):
        migrate(stored, bad)
    assert (_shape(stored), _rows(stored)) == before


def test_every_migration_runs_once_and_in_order(stored: Engine, later: Callable[..., Path]) -> None:
    migrate(stored, later(_NOTE(1)))
    migrate(stored, later(_NOTE(1), _NOTE(2)))
    migrate(stored, later(_NOTE(1), _NOTE(2)))
    with stored.connect() as connection:
        assert connection.scalar(text("SELECT name FROM scenes")) == "desk12"


def test_a_percent_sign_in_a_path_means_nothing(tmp_path: Path) -> None:
    folder = tmp_path / "100%s"
    shutil.copytree(_SCRIPTS, folder)
    engine = create_engine("sqlite://")
    migrate(engine, folder)
    assert _shape(engine).keys() == metadata.tables.keys()


def test_what_a_database_held_is_saved_before_it_is_upgraded(
    stored: Engine, later: Callable[..., Path], tmp_path: Path
) -> None:
    before = _rows(stored)
    scripts, save = later(_NOTE(1)), partial(save_before_upgrade, tmp_path)
    migrate(stored, scripts, save)
    saved = tmp_path / "before-upgrade"
    assert {path.name for path in saved.iterdir()} == {"backup.json", "fastsplat.sqlite"}
    copy = create_engine(f"sqlite:///{saved / 'fastsplat.sqlite'}")
    assert _rows(copy) == before != _rows(stored)
    copy.dispose()
    mtime = (saved / "backup.json").stat().st_mtime_ns
    migrate(stored, scripts, save)
    assert (saved / "backup.json").stat().st_mtime_ns == mtime, "what needs no upgrade is not saved again"


_VERSION_4 = (
    *(f"DROP TABLE {name}" for name in ("attempts", "turns", "leases")),
    *(f"DROP INDEX {name}" for name in ("operations_queued", "operations_by_state")),
    *(f"ALTER TABLE operations DROP {name}" for name in ("run_after", "again_after", "gpus", "memory", "models")),
    "CREATE INDEX ix_operations_state ON operations (state)",
    "ALTER TABLE operations ADD COLUMN attempts JSON DEFAULT '[]' NOT NULL",
    "UPDATE operations SET options = '{{\"labels\": [], \"models\": {models}}}', attempts = '{attempts}', attempt = 1",
    "UPDATE alembic_version SET version_num = '0004'",
)


def test_attempts_and_models_of_a_database_of_version_4_become_rows_and_columns(
    stored: Engine, tmp_path: Path, database_url: str, request: pytest.FixtureRequest
) -> None:
    shape, models = _shape(stored), {"tagger": {"name": "ram:mine", "sha256": {}}}
    attempts = [
        {"number": 1, "worker": "w", "began_at": began_at, "ended_at": 2.0, "why": why}
        for began_at, why in ((1.0, "failed"), (None, "cancelled"))
    ]
    with stored.begin() as connection:
        for statement in _VERSION_4:
            connection.exec_driver_sql(statement.format(models=json.dumps(models), attempts=json.dumps(attempts)))
    server: PostgresServer | None = request.getfixturevalue("postgres") if database_url else None
    with server.database() if server else nullcontext("") as another:
        for folder, url in ((tmp_path, database_url), (tmp_path / "restored", another)):
            if folder != tmp_path:
                restore(tmp_path / "before-upgrade", folder, url)
            with closing(open_store(folder, url)) as store:
                assert _shape(store.engine) == shape
                (job,) = store.jobs.in_turn(99)
                assert (job.models, job.options, job.again_after) == (models, {"labels": []}, "cancelled")
                (attempt,) = store.jobs.attempts_of([job.id])[job.id]
                assert (attempt.number, attempt.worker, attempt.why) == (1, "w", "failed")


def test_operations_are_found_by_upload_after_an_upgrade(stored: Engine, tmp_path: Path, database_url: str) -> None:
    shape = _shape(stored)
    with stored.begin() as connection:
        for statement in ("DROP INDEX operations_by_upload", "UPDATE alembic_version SET version_num = '0005'"):
            connection.execute(text(statement))
    with closing(open_store(tmp_path, database_url)) as store:
        assert _shape(store.engine) == shape


def test_a_database_that_cannot_be_saved_is_not_upgraded(
    stored: Engine, later: Callable[..., Path], tmp_path: Path
) -> None:
    before = _shape(stored), _rows(stored)
    (tmp_path / "before-upgrade").write_text("no folder")
    with pytest.raises(ResourceError) as caught:
        migrate(stored, later(_NOTE(1)), partial(save_before_upgrade, tmp_path))
    assert caught.value.field == "data_dir" and (_shape(stored), _rows(stored)) == before


def test_nothing_is_saved_of_a_new_database(stored: Engine, tmp_path: Path) -> None:
    assert not (tmp_path / "before-upgrade").exists()
