"""Identity of a deployment: a random id that a database and the place of its scenes share, so that neither is used with
another's.

The place is the data folder (its file `.identity`), or the object store (its object `identity`) where there is one.
Both get their id at the first start. Where one has it and the other has none, as a restored folder, the other gets the
same, if the database knows a scene of the folder or neither has any.
"""

from __future__ import annotations

import uuid

from sqlalchemy import Engine, delete, insert, select
from sqlalchemy.exc import IntegrityError

from fastsplat.service.store.blobs import Blobs
from fastsplat.service.store.database import transaction
from fastsplat.service.store.schema import identity, operations, scenes
from fastsplat_contract.errors import ConflictError

_ONE = 1
_HINT = (
    "Set FASTSPLAT_DATABASE_URL, FASTSPLAT_DATA_DIR and FASTSPLAT_ARTEFACTS__URL to what belongs together, mount its "
    "disks, or restore a backup into an empty folder. Whoever means these two: fastsplat doctor --adopt"
)


def check_identity(engine: Engine, blobs: Blobs) -> None:
    """Return if database and place share an id.

    Raises:
        ConflictError: they do not.
        DatabaseError, ObjectStoreError: one of them does not answer.
    """
    stored = _stored(engine)  # read first: whoever makes an id writes the place's first
    if stored is None or stored != blobs.identity():
        raise _foreign("the database belongs to another place of scenes")


def establish_identity(engine: Engine, blobs: Blobs) -> None:
    """Return if database and place share an id, or do from now on: a new database and an empty place, or two
    that know the same scenes.

    Several processes may do so at once.

    Raises:
        ConflictError: they have different ids; or one has none, and neither knows of the other's scenes.
        ResourceError: the place cannot be written.
        DatabaseError, ObjectStoreError: one of them does not answer.
    """
    stored, noted = _stored(engine), blobs.identity()
    if stored is None or noted is None:
        _check_related(engine, blobs)
        noted = blobs.keep_identity(noted or stored or uuid.uuid4().hex)
        stored = stored or _store(engine, noted)
    if stored != noted:
        raise _foreign("the database belongs to another place of scenes")


def check_new_database(blobs: Blobs) -> None:
    """Return if a database may be made for a place.

    Raises:
        ConflictError: there are scenes, which a new database would not know.
    """
    if there := blobs.ids("scenes"):
        raise _foreign(f"there is no database, but scenes are stored ({len(there)})")


def adopt(engine: Engine, blobs: Blobs) -> None:
    """Give database and place a new id, whatever they had. Nothing of either is erased; who had one of them before has
    it no more.

    Raises:
        ResourceError: the place cannot be written.
        DatabaseError, ObjectStoreError: one of them does not answer.
    """
    noted = blobs.keep_identity(uuid.uuid4().hex, replace=True)
    with transaction(engine) as connection:
        connection.execute(delete(identity))
        connection.execute(insert(identity).values(number=_ONE, id=noted))


def _check_related(engine: Engine, blobs: Blobs) -> None:
    """Ids are random: one scene that both have is proof enough."""
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
            connection.execute(insert(identity).values(number=_ONE, id=noted))
    except IntegrityError:  # another process was faster
        return _stored(engine)
    return noted


def _foreign(what: str) -> ConflictError:
    return ConflictError(f"{what}; nothing was changed", field="database_url", hint=_HINT)
