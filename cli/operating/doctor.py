"""`fastsplat doctor`: what is wrong with the data folder."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from fastsplat.cli.connection import local_store
from fastsplat.cli.lazy_settings import load_settings
from fastsplat_contract.errors import ConflictError, FastSplatError, NotFoundError, SceneFileError

if TYPE_CHECKING:
    from fastsplat.service.settings import Settings
    from fastsplat.service.store.care.checkup import Problem


def doctor(
    repair: Annotated[bool, typer.Option("--repair", help="Mend what can be mended without a decision.")] = False,
    adopt: Annotated[
        bool, typer.Option("--adopt", help="Use data folder and database together from now on; nothing is erased.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print a JSON array instead of lines.")] = False,
) -> None:
    """Check the data folder; status 1 if anything is wrong. The service may run meanwhile."""
    settings = load_settings()
    if not settings.data_dir.is_dir():
        raise NotFoundError(
            f"there is no data folder {settings.data_dir}",
            field="data_dir",
            hint="Set FASTSPLAT_DATA_DIR to yours, or make it: fastsplat serve.",
        )
    if adopt:
        with local_store(adopting=True):
            pass
    problems = _examine(settings)
    if repair and any(problem.mendable for problem in problems):
        _mend(settings, problems)
        problems = _examine(settings)
    if as_json:
        typer.echo(json.dumps([asdict(problem) for problem in problems], indent=2))
    else:
        for problem in problems:
            mendable = " Mended by --repair." if problem.mendable else ""
            typer.echo(f"{problem.place or settings.data_dir}: {problem.message}. {problem.hint}{mendable}".rstrip())
        if not problems:
            typer.echo("Nothing is wrong.")
    if problems:
        raise typer.Exit(1)


def _examine(settings: Settings) -> Sequence[Problem]:
    from fastsplat.service.application.editing.version_rows import version_of
    from fastsplat.service.application.jobs.stored import operation_of, scene_of  # loads what answers questions
    from fastsplat.service.store.care.checkup import (
        Problem,
        check_artefacts,
        check_database,
        check_folder,
        check_left_over,
    )
    from fastsplat.service.store.care.row_checkup import check_rows

    problems = list(check_folder(settings.data_dir, settings.uploads.min_free_bytes))
    of_database = check_database(settings.data_dir, settings.database_url)
    problems += of_database
    if of_database or not os.access(settings.data_dir, os.W_OK):
        return problems  # the rows cannot be read
    with ExitStack() as opened:
        try:
            store = opened.enter_context(local_store())
        except ConflictError as error:
            return [*problems, Problem("database", error.message, error.hint)]
        ids = {kind: store.blobs.ids(kind) for kind in ("jobs", "uploads", "scenes")}
        failed_since = time.time() - settings.uploads.failed_retention_s
        kept_since = time.time() - settings.jobs.ended_job_retention_s
        problems += check_rows(store, scene_of, operation_of, version_of, kept_since)
        problems += check_artefacts(store, _damage)
        problems += check_left_over(store, settings.uploads.expiry_s, failed_since, ids.__getitem__)
    return problems


def _mend(settings: Settings, problems: Sequence[Problem]) -> None:
    from fastsplat.service.store.blobs.blobs import PARTIAL_EXPIRY_S
    from fastsplat.service.store.care.checkup import mend_folder
    from fastsplat.workers.engine.cleanup import remove_unneeded

    mend_folder(settings.data_dir)
    if any(problem.place in ("database", "fastsplat.sqlite") and not problem.mendable for problem in problems):
        return
    with local_store() as store:  # brings an older schema to this release's
        uploads, retention_s = settings.uploads, settings.jobs.ended_job_retention_s
        remove_unneeded(store, uploads.expiry_s, retention_s, uploads.failed_retention_s)
        store.blobs.remove_partial(PARTIAL_EXPIRY_S)


def _damage(folder: Path) -> Iterator[FastSplatError]:
    """Reads a version as serving does, and checks every byte against its digest."""
    from fastsplat.service.scene.artefact.scene_files import read_scene
    from fastsplat.service.scene.formats.ply import read_ply

    read: dict[str, Mapping[str, Any]] = {}
    for name, reader in (("artefact", lambda path: read_scene(path).gaussians), ("scene.ply", read_ply)):
        try:
            read[name] = vars(reader(folder / name))
        except FastSplatError as error:
            yield error
    for name in ("means", "quats", "log_scales", "logit_opacities", "sh") if len(read) == 2 else ():
        if not np.array_equal(read["artefact"][name], read["scene.ply"][name]):
            yield SceneFileError(f"scene.ply has other {name} than the scene", field="scene.ply")
    try:
        json.loads((folder / "summary.json").read_text())
    except FileNotFoundError:
        pass  # versions that edits made have none; one that was published and is gone, its digest misses
    except (OSError, ValueError, RecursionError):
        yield SceneFileError("summary.json cannot be read", field="summary.json")
