"""The store: all durable state of one data folder."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from sqlalchemy import URL, Connection, Engine

from fastsplat.service.store.artefact_settings import ArtefactSettings
from fastsplat.service.store.blobs.blobs import Blobs
from fastsplat.service.store.blobs.object_store import open_blobs
from fastsplat.service.store.blobs.reserve import Reserve
from fastsplat.service.store.queue.job_repository import JobRepository
from fastsplat.service.store.queue.worker_repository import WorkerRepository
from fastsplat.service.store.repositories.key_repository import KeyRepository
from fastsplat.service.store.repositories.model_repository import ModelRepository
from fastsplat.service.store.repositories.name_repository import KnownNameRepository
from fastsplat.service.store.repositories.project_repository import ProjectRepository
from fastsplat.service.store.repositories.quota_usage import QuotaUsage
from fastsplat.service.store.repositories.scene_repository import SceneRepository
from fastsplat.service.store.repositories.upload_repository import UploadRepository
from fastsplat.service.store.repositories.version_repository import VersionRepository
from fastsplat.service.store.rows.database import open_engine, resolve_url
from fastsplat.service.store.rows.identity import adopt, check_new_database, establish_identity
from fastsplat.service.store.rows.migrations import Save
from fastsplat_contract.errors import FastSplatError, ObjectStoreError, ResourceError

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Store:
    """Repositories of rows and files; `jobs` and `workers` are for workers, `blobs` for all."""

    scenes: SceneRepository
    versions: VersionRepository
    jobs: JobRepository
    workers: WorkerRepository
    keys: KeyRepository
    projects: ProjectRepository
    quota_usage: QuotaUsage
    known_names: KnownNameRepository
    models: ModelRepository
    uploads: UploadRepository
    blobs: Blobs
    reserve: Reserve
    engine: Engine
    project: str = ""  # of `scenes`; "": all
    only_scene: str = ""  # id of the only scene; "": all

    def in_project(self, project: str, scene_id: str = "") -> Store:
        """Narrows the store to a project's scenes, operations and names, and optionally to one scene."""
        scenes, names = SceneRepository(self.engine, project, scene_id), KnownNameRepository(self.engine, project)
        return replace(self, scenes=scenes, known_names=names, project=project, only_scene=scene_id)

    def close(self) -> None:
        self.engine.dispose()


def open_store(
    data_dir: Path, database_url: str = "", artefacts: ArtefactSettings | None = None, *, adopting: bool = False
) -> Store:
    """Opens the store of a data folder, making folder and tables on first use.

    Args:
        data_dir: the folder.
        database_url: empty for SQLite in the folder.
        artefacts: where scenes are stored; None: in the folder.
        adopting: pair folder and database from now on, whatever they belonged to.

    Raises:
        InvalidInputError: a URL cannot be read.
        ConflictError: database and folder do not belong together, or this release cannot read the database.
        ResourceError: the folder or the database cannot be used.
    """
    try:
        data_dir.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError as error:
        raise ResourceError(
            f"the data folder cannot be made: {error.strerror}",
            field="data_dir",
            hint="Point FASTSPLAT_DATA_DIR at a writable folder.",
        ) from error
    if not os.access(data_dir, os.W_OK):
        raise ResourceError(
            "the data folder cannot be written: its file system is read-only, or it is another user's",
            field="data_dir",
            hint="Mount its disk for writing or mend its owner; or point FASTSPLAT_DATA_DIR at a writable folder.",
        )
    url = resolve_url(data_dir, database_url)
    blobs = open_blobs(data_dir.resolve(), artefacts or ArtefactSettings())
    engine = _open_own(url, blobs, adopting, partial(_save_before_upgrade, data_dir.resolve()))
    reserve = Reserve(data_dir.resolve())
    if engine.dialect.name == "sqlite":
        reserve.fill()
    return Store(
        scenes=SceneRepository(engine),
        versions=VersionRepository(engine),
        jobs=JobRepository(engine, blobs.clock()),
        workers=WorkerRepository(engine),
        keys=KeyRepository(engine),
        projects=ProjectRepository(engine),
        quota_usage=QuotaUsage(engine),
        known_names=KnownNameRepository(engine),
        models=ModelRepository(engine),
        uploads=UploadRepository(engine),
        blobs=blobs,
        reserve=reserve,
        engine=engine,
    )


def _save_before_upgrade(data_dir: Path, live: Connection, bring: Callable[[Connection], None]) -> None:
    from fastsplat.service.store.rows.before_upgrade import save_before_upgrade  # only where there is an upgrade

    save_before_upgrade(data_dir, live, bring)


def _open_own(url: URL, blobs: Blobs, adopting: bool, save: Save) -> Engine:
    """Opens the database that belongs to the scene storage."""
    if adopting:
        engine = open_engine(url, save)
        adopt(engine, blobs)
        return engine
    try:
        if url.get_backend_name() == "sqlite" and not Path(str(url.database)).exists():
            check_new_database(blobs)
        engine = open_engine(url, save)
        try:
            establish_identity(engine, blobs)
        except FastSplatError:
            engine.dispose()
            raise
    except ObjectStoreError as error:  # cleanup checks the identity before it removes anything there
        _log.warning("whether the object store belongs to this database is not known: %s", error.message)
        engine = open_engine(url, save)
    return engine
