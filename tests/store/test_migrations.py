"""Migrations: a database of every earlier release becomes this release's, with everything in it; none goes back."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, nullcontext
from pathlib import Path
from typing import Any

import pytest
from alembic.autogenerate import compare_metadata
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import Engine, create_engine, inspect, text

from fastsplat.service.store.backup import restore
from fastsplat.service.store.codec import options_from_json
from fastsplat.service.store.database import open_engine, resolve_url
from fastsplat.service.store.migrations import migrate
from fastsplat.service.store.schema import metadata
from fastsplat.service.store.store import Store, open_store
from fastsplat_contract.errors import ConflictError, NotFoundError, ResourceError
from tests.postgres import PostgresServer

_HERE = Path(__file__).parent
_FIRST_RELEASE, _BEFORE_ALEMBIC = "first_release.sql", "before_alembic.sql"
_NEW_COLUMNS = {
    "scenes": {"project", "scaling", "alignment", "things"},
    "operations": {"project", "finish_requested", "progress_files", "worker"},
    "api_keys": {"project", "scene_id", "operation_id"},
    "scene_versions": {"author", "current_at", "scaling", "alignment", "quality", "things"},
}
"""What came to each table since the last release before alembic."""
_SCRIPTS = Path(sys.modules[migrate.__module__].__file__ or "").parent


@pytest.fixture
def empty(tmp_path: Path, database_url: str) -> Iterator[Engine]:
    """A database without any table, and the folder of the scene that the databases of before have."""
    (tmp_path / "scenes" / "done").mkdir(parents=True)
    engine = open_engine(resolve_url(tmp_path, database_url))
    _clear(engine)
    yield engine
    engine.dispose()


@pytest.fixture(params=[_FIRST_RELEASE, _BEFORE_ALEMBIC])
def old(request: pytest.FixtureRequest, empty: Engine) -> Engine:
    """A database as the first release left it, and as the last one before alembic did."""
    return _fill(empty, request.param)


def _clear(engine: Engine) -> None:
    with engine.begin() as connection:
        metadata.drop_all(connection)
        connection.execute(text("DROP TABLE IF EXISTS alembic_version"))


def _fill(engine: Engine, name: str) -> Engine:
    sql = (_HERE / name).read_text()
    if engine.dialect.name == "sqlite":
        sql = sql.replace("DOUBLE PRECISION", "DOUBLE")
    with engine.begin() as connection:
        for statement in sql.split(";\n"):
            if statement.strip():
                connection.exec_driver_sql(statement)
    return engine


def _shape(engine: Engine) -> dict[str, Any]:
    """Everything that a schema promises; defaults aside, which migrations need and new tables may not."""
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


def _rows(engine: Engine) -> dict[str, list[Any]]:
    with engine.connect() as connection:
        names = [name for name in inspect(connection).get_table_names() if name in metadata.tables]
        return {name: sorted(map(repr, connection.execute(text(f"SELECT * FROM {name}")))) for name in names}


def _columns_of_all(engine: Engine) -> dict[str, list[dict[str, Any]]]:
    with engine.connect() as connection:
        names = [name for name in inspect(connection).get_table_names() if name not in ("alembic_version", "projects")]
        rows = {name: connection.execute(text(f"SELECT * FROM {name}")).mappings() for name in names}
        return {name: sorted(map(dict, each), key=repr) for name, each in rows.items()}


def test_an_earlier_releases_database_and_a_new_one_become_the_same_as_the_tables(empty: Engine) -> None:
    with empty.begin() as connection:
        metadata.create_all(connection)
    tables = _shape(empty)
    for name in (_FIRST_RELEASE, _BEFORE_ALEMBIC, None):
        _clear(empty)
        if name:
            _fill(empty, name)
        migrate(empty)
        assert _shape(empty) == tables
        with empty.connect() as connection:
            assert compare_metadata(MigrationContext.configure(connection), metadata) == []


def test_a_database_between_two_releases_becomes_the_same_too(empty: Engine) -> None:
    _fill(empty, _BEFORE_ALEMBIC)
    with empty.begin() as connection:  # as a release left it that knew priorities, but no keys and quotas
        connection.execute(text("DROP TABLE holdings"))
        connection.execute(text("DROP TABLE api_keys"))
    migrate(empty)
    with empty.connect() as connection:
        assert compare_metadata(MigrationContext.configure(connection), metadata) == []


def test_what_the_first_release_stored_is_there_and_goes_on(empty: Engine, tmp_path: Path, database_url: str) -> None:
    _fill(empty, _FIRST_RELEASE)
    store = open_store(tmp_path, database_url)
    scene = store.scenes.scene("done")
    assert (scene.name, scene.state, scene.gaussians, scene.quality) == ("desk", "READY", 7, {"psnr": 30.0})
    assert store.scenes.operation("op_done").priority == 0
    assert [(job.id, job.priority) for job in store.jobs.waiting()] == [("op_new", 0)]
    claim = store.jobs.claim("op_new")
    assert claim is not None and claim.operation.options["labels"] == ["mug"]
    store.close()


def test_what_the_last_release_before_alembic_stored_is_there_and_goes_on(
    empty: Engine, tmp_path: Path, database_url: str
) -> None:
    _fill(empty, _BEFORE_ALEMBIC)
    before = _columns_of_all(empty)
    migrate(empty)
    after = _columns_of_all(empty)
    assert {
        table: [row.keys() - old.keys() for row, old in zip(after[table], rows, strict=True)]
        for table, rows in before.items()
    } == {table: [_NEW_COLUMNS.get(table, set())] * len(rows) for table, rows in before.items()}
    changed = {
        (table, name): (old[name], row.get(name))
        for table, rows in before.items()
        for old, row in zip(rows, after[table], strict=True)
        for name in old
        if row.get(name) != old[name]
    }
    assert changed == {
        ("api_keys", "kind"): ("read", "reader"),
        ("holdings", "owner"): ("0123456789ab", None),
        ("operations", "enqueued"): (0, None),
        ("schema_version", "version"): (2, 18),
    }
    assert all(row.get("project", "default") == "default" for rows in after.values() for row in rows)
    store = open_store(tmp_path, database_url)
    with pytest.raises(NotFoundError):
        store.in_project("another").scenes.scene("done")
    mine = store.in_project("default").scenes
    assert [scene.id for scene in mine.list_scenes(9)] == ["new", "done"] and mine.operation("op_done")
    again = mine.find_request("once", "d")
    assert again is not None and again.id == "op_done"
    scene = store.scenes.scene("done")
    assert [version.version for version in store.versions.of(scene)] == ["op_done", "v2"]
    assert [(key.name, key.role, key.project) for key in store.keys.all()] == [("robot", "reader", "default")]
    usage = store.quota_usage.of("default")
    assert (usage.scenes, usage.stored_bytes, usage.queued_jobs) == (1, 4096, 1)  # op_new waits
    assert [worker.heartbeat_at for worker in store.workers.list_workers()] == [1000.5]
    assert [(job.id, job.priority) for job in store.jobs.waiting()] == [("op_new", 5)]
    options = options_from_json(store.scenes.operation("op_new").options)
    assert (options.labels, options.preset, options.max_gaussians) == (("mug",), "draft", 500)
    store.close()


def test_versions_of_the_same_number_get_different_ones_by_age(empty: Engine) -> None:
    _fill(empty, _BEFORE_ALEMBIC)
    row = (
        "INSERT INTO scene_versions (scene_id, version, number, parent, created_at, request_digest, gaussians, "
        "dictionary, edits) VALUES ('{}', '{}', {}, '{}', {}, '', 1, '[]', '[]')"
    ).format
    doubled = [("t", 1, "", 9.0), ("b", 4, "a", 3.0), ("a", 4, "t", 2.0), ("d", 4, "c", 5.0), ("c", 4, "b", 4.0)]
    with empty.begin() as connection:
        for version, number, parent, created_at in doubled:
            connection.execute(text(row("doubled", version, number, parent, created_at)))
        for version, number, created_at in (("t", 1, 1.0), ("x", 5, 3.0), ("y", 7, 2.0)):
            connection.execute(text(row("sound", version, number, "t" if number > 1 else "", created_at)))
    migrate(empty)
    numbers = text("SELECT version, number FROM scene_versions WHERE scene_id = :scene ORDER BY number")
    with empty.connect() as connection:
        after = {scene: list(connection.execute(numbers, {"scene": scene})) for scene in ("doubled", "sound")}
    assert after == {
        "doubled": [("t", 1), ("a", 2), ("b", 3), ("c", 4), ("d", 5)],
        "sound": [("t", 1), ("x", 5), ("y", 7)],
    }


def test_opening_twice_and_by_many_at_once_changes_nothing_more(old: Engine, tmp_path: Path, database_url: str) -> None:
    barrier = threading.Barrier(6)

    def open_it(_: int) -> Store:
        barrier.wait()
        return open_store(tmp_path, database_url)

    with ThreadPoolExecutor(6) as pool:
        stores = list(pool.map(open_it, range(6)))
    for store in stores:
        assert len(store.scenes.list_scenes(10)) == 2
        store.close()
    with old.connect() as connection:
        for table in ("alembic_version", "schema_version", "identity"):
            assert connection.scalar(text(f"SELECT count(*) FROM {table}")) == 1


_OPEN = """
import sys
from pathlib import Path
from fastsplat.service.store.store import open_store
print("ready", flush=True)
sys.stdin.readline()
store = open_store(Path(sys.argv[1]), sys.argv[2])
print(len(store.scenes.list_scenes(10)))
"""


def test_processes_that_start_at_once_migrate_once(empty: Engine, tmp_path: Path, database_url: str) -> None:
    _fill(empty, _FIRST_RELEASE)
    command = [sys.executable, "-c", _OPEN, str(tmp_path), database_url]
    pipe = subprocess.PIPE
    processes = [subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) for _ in range(3)]
    for process in processes:
        assert process.stdin is not None and process.stdout is not None
        assert process.stdout.readline() == "ready\n"
    for process in processes:
        assert process.stdin is not None
        process.stdin.write("go\n")
        process.stdin.flush()
    assert [process.communicate()[0] for process in processes] == ["2\n"] * 3
    with empty.connect() as connection:
        assert connection.scalar(text("SELECT count(*) FROM alembic_version")) == 1


def test_a_database_of_a_later_release_is_refused_unchanged(old: Engine, tmp_path: Path, database_url: str) -> None:
    migrate(old)
    before = _rows(old)
    with old.begin() as connection:
        connection.execute(text("UPDATE alembic_version SET version_num = '1000'"))
    with pytest.raises(ConflictError, match="version 1000") as caught:
        open_store(tmp_path, database_url)
    assert caught.value.hint and caught.value.field == "database_url"
    assert _rows(old) == before
    with old.connect() as connection:
        assert connection.scalar(text("SELECT version_num FROM alembic_version")) == "1000"


def test_releases_before_alembic_find_the_version_in_their_own_table(old: Engine, later: Callable[..., Path]) -> None:
    migrate(old, later("pass"))
    with old.connect() as connection:
        assert connection.scalar(text("SELECT version FROM schema_version")) == _newest() + 1


@pytest.fixture
def later(tmp_path: Path) -> Callable[..., Path]:
    """Makes an alembic folder with more revisions than the product's: the bodies of their `upgrade`."""

    def make(*bodies: str) -> Path:
        folder = tmp_path / f"migrations{len(bodies)}"
        shutil.copytree(_SCRIPTS, folder, dirs_exist_ok=True)
        for number, body in enumerate(bodies, start=_newest() + 1):
            lines = (
                "import sqlalchemy as sa", "from alembic import op",
                f"revision, down_revision = '{number:04}', '{number - 1:04}'", f"def upgrade(): {body}",
            )  # fmt: skip
            (folder / "versions" / f"v{number:04}_test.py").write_text("\n".join(lines))
        return folder

    return make


def _newest() -> int:
    config = Config()
    config.set_main_option("script_location", str(_SCRIPTS))
    head = ScriptDirectory.from_config(config).get_current_head()
    assert head is not None
    return int(head)


def test_file_names_bear_the_revisions_in_one_line() -> None:
    config = Config()
    config.set_main_option("script_location", str(_SCRIPTS))
    revisions = list(ScriptDirectory.from_config(config).walk_revisions())[::-1]
    assert [revision.revision for revision in revisions] == [f"{n:04}" for n in range(1, len(revisions) + 1)]
    assert [Path(revision.path).name[1:5] for revision in revisions] == [each.revision for each in revisions]


def test_a_migration_that_fails_leaves_the_database_as_it_was(old: Engine, later: Callable[..., Path]) -> None:
    before = _shape(old), _rows(old)
    bad = later("op.add_column('scenes', sa.Column('half', sa.Integer)); raise RuntimeError('a defect')")
    with pytest.raises(RuntimeError, match="a defect"):
        migrate(old, bad)
    assert (_shape(old), _rows(old)) == before


def test_every_migration_runs_once_and_in_order(old: Engine, later: Callable[..., Path]) -> None:
    note = "op.execute(\"UPDATE scenes SET name = name || '{}' WHERE id = 'done'\")".format
    migrate(old)
    migrate(old, later(note(1)))
    migrate(old, later(note(1), note(2)))
    migrate(old, later(note(1), note(2)))
    with old.connect() as connection:
        assert connection.scalar(text("SELECT name FROM scenes WHERE id = 'done'")) == "desk12"


def test_a_percent_sign_in_a_path_means_nothing(tmp_path: Path) -> None:
    folder = tmp_path / "100%s"
    shutil.copytree(_SCRIPTS, folder)
    engine = create_engine("sqlite://")
    migrate(engine, folder)
    assert _shape(engine).keys() == metadata.tables.keys()


def _release(engine: Engine, number: int, folder: Path) -> None:
    """Make a database that of the release whose newest revision has this number."""
    shutil.copytree(_SCRIPTS, folder)
    for path in (folder / "versions").glob("v*.py"):
        if int(path.name[1:5]) > number:
            path.unlink()
    migrate(engine, folder)


def _plain(rows: list[dict[str, Any]], names: set[str]) -> list[str]:
    """Rows of these columns, whichever database wrote them: SQLite's booleans are numbers, and its JSON is text."""

    def plain(value: Any) -> Any:
        written = isinstance(value, str) and (value[:1] in ("{", "[") or value == "null")
        return json.loads(value) if written else int(value) if isinstance(value, bool) else value

    return sorted(repr({name: plain(row[name]) for name in sorted(names)}) for row in rows)


@pytest.mark.parametrize("number", [None, 1, 9, 14])
def test_what_a_database_held_is_saved_before_it_is_upgraded_and_can_be_restored(
    number: int | None, empty: Engine, tmp_path: Path, database_url: str, request: pytest.FixtureRequest
) -> None:
    _fill(empty, _FIRST_RELEASE if number == 1 else _BEFORE_ALEMBIC)
    if number is not None and number > 1:
        _release(empty, number, tmp_path / "scripts")
    before = _columns_of_all(empty)
    open_store(tmp_path, database_url).close()
    saved = tmp_path / "before-upgrade"
    assert {path.name for path in saved.iterdir()} == {"backup.json", "fastsplat.sqlite"}
    copy = create_engine(f"sqlite:///{saved / 'fastsplat.sqlite'}")
    kept = _columns_of_all(copy)
    assert before.keys() <= kept.keys()
    for table, rows in before.items():
        names = set(rows[0]) if rows else set()
        if table != "schema_version" or number is not None:
            assert _plain(kept[table], names) == _plain(rows, names), table
    if number is not None and number > 1:
        with copy.connect() as connection:
            assert connection.scalar(text("SELECT version_num FROM alembic_version")) == f"{number:04}"
    copy.dispose()

    server: PostgresServer | None = request.getfixturevalue("postgres") if database_url else None
    with server.database() if server else nullcontext("") as another:
        restore(saved, tmp_path / "restored", another)
        shutil.copytree(tmp_path / "scenes", tmp_path / "restored" / "scenes")
        with closing(open_store(tmp_path / "restored", another)) as store:
            assert {scene.id for scene in store.scenes.list_scenes(10)} == {"new", "done"}
            assert [job.id for job in store.jobs.waiting()] == ["op_new"]

    marked = saved / "backup.json"
    made = marked.stat().st_mtime_ns
    open_store(tmp_path, database_url).close()
    assert marked.stat().st_mtime_ns == made, "what needs no upgrade is not saved again"


def test_a_database_that_cannot_be_saved_is_not_upgraded(old: Engine, tmp_path: Path, database_url: str) -> None:
    before = _shape(old), _rows(old)
    (tmp_path / "before-upgrade").write_text("no folder")
    with pytest.raises(ResourceError) as caught:
        open_store(tmp_path, database_url)
    assert caught.value.field == "data_dir" and (_shape(old), _rows(old)) == before


def test_nothing_is_saved_of_a_new_database(empty: Engine, tmp_path: Path, database_url: str) -> None:
    (tmp_path / "scenes" / "done").rmdir()
    open_store(tmp_path, database_url).close()
    assert not (tmp_path / "before-upgrade").exists()
