"""Durable state: rows in a database, blobs on disk."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from sqlalchemy import Engine

from fastsplat.service.store.blobs import Blobs
from fastsplat.service.store.engine import open_engine, resolve_url
from fastsplat.service.store.holdings import HoldingRows
from fastsplat.service.store.jobs import JobRows
from fastsplat.service.store.keys import KeyRows
from fastsplat.service.store.objects import open_blobs
from fastsplat.service.store.rows import Rows
from fastsplat.service.store.settings import ArtefactSettings
from fastsplat.service.store.versions import VersionRows
from fastsplat_contract.errors import ResourceError


@dataclass(frozen=True)
class Store:
    """All that is durable: `jobs` for the workers, `blobs` for all, the others for the faces."""

    rows: Rows
    versions: VersionRows
    jobs: JobRows
    keys: KeyRows
    holdings: HoldingRows
    blobs: Blobs
    engine: Engine

    def close(self) -> None:
        """Give the connections back."""
        self.engine.dispose()


def open_store(data_dir: Path, database_url: str = "", artefacts: ArtefactSettings | None = None) -> Store:
    """Open, and on first use make, the data folder and the tables.

    Raises:
        InvalidInputError: a URL cannot be read.
        ResourceError: the folder or the database cannot be used.
    """
    try:
        data_dir.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ResourceError(
            f"the data folder cannot be made: {error.strerror}",
            field="data_dir",
            hint="Point FASTSPLAT_DATA_DIR at a writable folder.",
        ) from error
    engine = open_engine(resolve_url(data_dir, database_url, sqlite_name="fastsplat.sqlite"))
    blobs = open_blobs(data_dir.resolve(), artefacts or ArtefactSettings())
    return Store(
        Rows(engine),
        VersionRows(engine),
        JobRows(engine),
        KeyRows(engine),
        HoldingRows(engine),
        blobs,
        engine,
    )
