"""Unfinished resumable uploads in the database; their bytes are files or objects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

from sqlalchemy import delete, insert, select, update

from fastsplat.service.store.rows.database import Repository
from fastsplat.service.store.rows.schema import resumable_uploads as table


@dataclass(frozen=True)
class UploadRecord:
    """An announced file; `expires_at` is in seconds since 1970 by the clock of the bytes' storage."""

    id: str
    project: str
    key_id: str  # of the upload key that announced it; "" for other keys
    name: str  # of the file in the capture
    length: int  # announced bytes
    metadata: str  # as sent by the client
    expires_at: float
    offset: int = 0  # durable bytes
    pieces: Sequence[str] = ()  # names of their objects in an object store


class UploadRepository(Repository):
    """Rows of uploads; each method is one transaction and may raise `DatabaseError`."""

    def add(self, record: UploadRecord) -> None:
        with self._writing() as connection:
            connection.execute(insert(table).values(asdict(record)))

    def find(self, upload_id: str) -> UploadRecord | None:
        with self._reading() as connection:
            row = connection.execute(select(table).where(table.c.id == upload_id)).mappings().first()
        return None if row is None else UploadRecord(**row)

    def of(self, project: str, now: float) -> Sequence[UploadRecord]:
        """Lists a project's uploads that have not expired at `now`."""
        with self._reading() as connection:
            rows = connection.execute(select(table).where(table.c.project == project, table.c.expires_at > now))
            return [UploadRecord(**row) for row in rows.mappings()]

    def advance(self, before: UploadRecord, after: UploadRecord) -> bool:
        """Replaces a row, unless other bytes were counted since it was read, or it is gone: then False."""
        same = update(table).where(table.c.id == before.id, table.c.offset == before.offset)
        with self._writing() as connection:
            return connection.execute(same.values(asdict(after))).rowcount > 0

    def remove(self, upload_id: str) -> None:
        with self._writing() as connection:
            connection.execute(delete(table).where(table.c.id == upload_id))
