"""Deployment identity: a random id shared by a database and its scene storage.

It keeps either from being used with another's. The storage is the data folder (file `.identity`) or the object store
(object `identity`). Both get the id at the first start. If only one has it, as after a restored folder, the other takes
it over, provided that they have a scene in common or both have none. All functions raise `DatabaseError` or
`ObjectStoreError` if one of them does not answer.
"""

from __future__ import annotations

import uuid

from sqlalchemy import Engine, delete, insert, select
from sqlalchemy.exc import IntegrityError

from fastsplat.service.store.blobs.blobs import Blobs
from fastsplat.service.store.rows.database import transaction
from fastsplat.service.store.rows.schema import identity, operations, scenes
from fastsplat_contract.errors import ConflictError

_ROW_NUMBER = 1
_HINT = (
    "Set FASTSPLAT_DATABASE_URL, FASTSPLAT_DATA_DIR and FASTSPLAT_ARTEFACTS__URL to what belongs together, mount its "
    "disks, or restore a backup into an empty folder. Whoever means these two: fastsplat doctor --adopt"
)


def check_identity(engine: Engine, blobs: Blobs) -> None:
    """Raises `ConflictError` unless database and storage share an id."""
    stored = _stored(engine)  # read first: a new id is written to the storage first
    if stored is None or stored != blobs.identity():
        raise _foreign("the database belongs to another place of scenes")


def establish_identity(engine: Engine, blobs: Blobs) -> None:
    """Checks that database and storage share an id, or gives them one.

    Safe from several processes.

    Raises:
        ConflictError: the ids differ, or one has none and they have no scene in common.
        ResourceError: the storage cannot be written.
    """
    stored, noted = _stored(engine), blobs.identity()
    if stored is None or noted is None:
        _check_related(engine, blobs)
        noted = blobs.keep_identity(noted or stored or uuid.uuid4().hex)
        stored = stored or _store(engine, noted)
    if stored != noted:
        raise _foreign("the database belongs to another place of scenes")


def check_new_database(blobs: Blobs) -> None:
    """Raises `ConflictError` if the storage holds scenes, which a new database would not know."""
    if there := blobs.ids("scenes"):
        raise _foreign(f"there is no database, but scenes are stored ({len(there)})")


def adopt(engine: Engine, blobs: Blobs) -> None:
    """Gives database and storage a new shared id; raises `ResourceError` if it cannot be written."""
    noted = blobs.keep_identity(uuid.uuid4().hex, replace=True)
    with transaction(engine) as connection:
        connection.execute(delete(identity))
        connection.execute(insert(identity).values(number=_ROW_NUMBER, id=noted))


def _check_related(engine: Engine, blobs: Blobs) -> None:
    """Checks that both know a common scene; ids are random, so one is proof enough."""
    there = frozenset(blobs.ids("scenes"))
    with transaction(engine.execution_options(read_only=True)) as connection:
        ready = frozenset(connection.scalars(select(scenes.c.id).where(scenes.c.version != "")))
        known = frozenset(connection.scalars(select(scenes.c.id).union(select(operations.c.scene_id))))
    if there and not there & known:
        raise _foreign(f"the database knows none of the {len(there)} scenes that are stored")
    if ready and not there:
        raise _foreign(f"none of the {len(ready)} scenes that the database names is stored")


def _stored(engine: Engine) -> str | None:
    with transaction(engine.execution_options(read_only=True)) as connection:
        stored: str | None = connection.scalar(select(identity.c.id))
    return stored


def _store(engine: Engine, noted: str) -> str | None:
    try:
        with transaction(engine) as connection:
            connection.execute(insert(identity).values(number=_ROW_NUMBER, id=noted))
    except IntegrityError:  # another process was faster
        return _stored(engine)
    return noted


def _foreign(what: str) -> ConflictError:
    return ConflictError(f"{what}; nothing was changed", field="database_url", hint=_HINT)
