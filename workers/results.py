"""Stage results in a job's work folder: whole or absent, each written by one attempt."""

from __future__ import annotations

import errno
import json
import re
import shutil
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

from fastsplat.service.common.atomic import publish_directory
from fastsplat.service.store.blobs import remove
from fastsplat.service.store.file_digests import DIGESTS, check_files, write_digests
from fastsplat.workers.protocol import Job
from fastsplat_contract.errors import ArtefactError, FastSplatError, Kind, ResourceError, SceneFileError

PHOTOS = "photos.json"
"""What became of each photo, in the result of the capture stage."""
KEPT = ".made"
"""Ends the name of a last stage's result that is kept as edits of a draft have yet to be made again in it."""
_TIMES = "stage.json"
RESULT_FILES = (_TIMES, DIGESTS)
"""What stands beside a stage's own files in its result."""
DISK_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def start_stage(job: Job, stage: str) -> Path:
    """An empty folder for a stage's result, of this attempt alone."""
    folder = job.folder / f"{stage}.{job.attempt}.part"
    remove(folder)
    folder.mkdir(parents=True)
    return folder


def finish_stage(job: Job, stage: str, folder: Path, seconds: float) -> None:
    """Publish a stage's result, durably. If another attempt was faster, its result stays."""
    (folder / _TIMES).write_text(json.dumps({"seconds": seconds, "attempt": job.attempt}))
    write_digests(folder)
    try:
        publish_directory(folder, job.result(stage))
    except FileExistsError:
        remove(folder)


def discard_damaged(job: Job) -> tuple[str, ...]:
    """Take away the first stage's result that is not as it was written, and those after it, because they were made of
    it; returns the stages that are to be done again for that.
    """
    done = [stage for stage in job.stages if job.result(stage).is_dir()]
    for number, stage in enumerate(done):
        try:
            check_files(job.result(stage))
        except (SceneFileError, OSError) as error:
            print(f"the result of {stage} is damaged, it is made again: {error}", file=sys.stderr, flush=True)
            for gone in reversed(done[number:]):
                unfinished = job.folder / f"{gone}.{job.attempt}.part"  # what `start_stage` begins with
                remove(unfinished)
                job.result(gone).rename(unfinished)
            return tuple(done[number:])
    return ()


@contextmanager
def intact(path: Path) -> Iterator[None]:
    """A block that reads a file of an earlier stage's result.

    Raises:
        ArtefactError: it is damaged; names it.
    """
    try:
        yield
    except (ValueError, KeyError, TypeError, AttributeError, BadZipFile) as error:
        raise ArtefactError(
            f"{path.parent.name}/{path.name}, the result of an earlier stage, is damaged ({type(error).__name__})",
            field=path.name,
            hint="Retry the operation.",
        ) from error


def stage_seconds(job: Job, stage: str) -> float:
    """How long the attempt that finished a stage needed for it."""
    path = job.result(stage) / _TIMES
    with intact(path):
        return float(json.loads(path.read_text())["seconds"])


def checkpoint_folder(job: Job) -> Path:
    """Folder of this attempt's checkpoints, begun as a copy of the newest earlier attempt's, if any.

    A suspended worker's trainer may wake and go on writing; it writes to its own attempt's folder.
    """
    mine = job.folder / f"checkpoint.{job.attempt}"
    if mine.is_dir():
        return mine
    earlier = {
        int(match[1]): path
        for path in job.folder.iterdir()
        if (match := re.fullmatch(r"checkpoint\.(\d+)", path.name)) and int(match[1]) < job.attempt
    }
    copying = job.folder / f"checkpoint.{job.attempt}.part"
    remove(copying)
    if earlier:
        shutil.copytree(earlier[max(earlier)], copying)
    else:
        copying.mkdir()
    copying.rename(mine)
    return mine


def operation_error(error: Exception, stage: str, job: Job) -> dict[str, Any]:
    """An exception as an `OperationError` in JSON; the traceback goes to the log."""
    with suppress(OSError):  # the log's own disk may be the full one
        traceback.print_exception(error)
    if isinstance(error, MemoryError):
        error = ResourceError(
            "the trainer ran out of memory", field=stage, hint="Use fewer or smaller images, or a larger machine."
        )
    if isinstance(error, OSError) and error.errno in DISK_FULL:
        error = disk_full_error()
    if isinstance(error, FastSplatError):
        return {**error_to_json(error, stage), "photos": _blamed_photos(error.field, job)}
    message = f"{type(error).__name__}: {error}"[:500]
    details = {"hint": "This is a defect of the server; its operator finds the trace in the log.", "log": _log(job)}
    return {
        "kind": Kind.INTERNAL.value, "reason": "INTERNAL", "message": message, "stage": stage, "details": details
    }  # fmt: skip


def disk_full_error() -> ResourceError:
    """The error of a job that ends because the disk is full."""
    return ResourceError(
        "the disk is full", field="data_dir", hint="Free space in the server's data folder, then retry the operation."
    )


def error_to_json(error: FastSplatError, stage: str, **more: str) -> dict[str, Any]:
    """A typed error as the durable `OperationError`."""
    return {
        "kind": error.kind.value,
        "reason": error.reason,
        "message": error.message,
        "stage": stage,
        "details": {**error.details(), **more},
        "recurs": error.recurs,
    }


def _blamed_photos(field: str, job: Job) -> list[str]:
    """The name of the photo that an error names as its field, or whose label map it names; empty if it names none."""
    # A worker, which shares this file, never reads images.
    from fastsplat.service.capture.formats.upload_manifest import read_manifest

    try:
        manifest, _ = read_manifest(job.upload)
    except (OSError, ValueError, TypeError, KeyError, FastSplatError):  # a finished scene's folder, a damaged upload
        return []
    photos = zip(manifest.photos, manifest.names, strict=True)
    return [name for photo, name in photos if field in (name, photo.path, manifest.label_maps.get(photo.path))]


def _log(job: Job) -> str:
    return f"logs/{job.operation_id}.log"
