"""Stage results in a job's work folder: complete or absent, each by one attempt."""

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

from fastsplat.service.common.files import publish_directory
from fastsplat.service.store.blobs.blobs import remove
from fastsplat.service.store.blobs.file_digests import DIGESTS, check_files, write_digests
from fastsplat.workers.job.protocol import Job
from fastsplat_contract.errors import ArtefactError, FastSplatError, Kind, ResourceError, SceneFileError

PHOTOS = "photos.json"
"""File of the capture stage with each photo's result."""
SPARE_SUFFIX = ".made"
"""Suffix of a kept last-stage result whose draft edits must be repeated."""
_TIMES = "stage.json"
RESULT_FILES = (_TIMES, DIGESTS)  # beside a stage's own files in its result
DISK_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def start_stage(job: Job, stage: str) -> Path:
    """Creates an empty folder for this attempt's stage result."""
    folder = job.folder / f"{stage}.{job.attempt}.part"
    remove(folder)
    folder.mkdir(parents=True)
    return folder


def finish_stage(job: Job, stage: str, folder: Path, seconds: float) -> None:
    """Publishes a stage's result durably, unless another attempt was faster."""
    (folder / _TIMES).write_text(json.dumps({"seconds": seconds, "attempt": job.attempt}))
    write_digests(folder)
    try:
        publish_directory(folder, job.result(stage))
    except FileExistsError:
        remove(folder)


def discard_damaged(job: Job) -> tuple[str, ...]:
    """Discards the first damaged stage result and all later ones; returns their stages."""
    done = [stage for stage in job.stages if job.result(stage).is_dir()]
    for number, stage in enumerate(done):
        try:
            check_files(job.result(stage))
        except (SceneFileError, OSError) as error:
            print(f"the result of {stage} is damaged, it is made again: {error}", file=sys.stderr, flush=True)
            for gone in reversed(done[number:]):
                unfinished = job.folder / f"{gone}.{job.attempt}.part"  # emptied by `start_stage`
                remove(unfinished)
                job.result(gone).rename(unfinished)
            return tuple(done[number:])
    return ()


@contextmanager
def intact(path: Path) -> Iterator[None]:
    """Turns read errors of a file of an earlier stage into `ArtefactError`."""
    try:
        yield
    except (ValueError, KeyError, TypeError, AttributeError, BadZipFile) as error:
        raise ArtefactError(
            f"{path.parent.name}/{path.name}, the result of an earlier stage, is damaged ({type(error).__name__})",
            field=path.name,
            hint="Retry the operation.",
        ) from error


def stage_seconds(job: Job, stage: str) -> float:
    """Returns the duration of the attempt that finished a stage."""
    path = job.result(stage) / _TIMES
    with intact(path):
        return float(json.loads(path.read_text())["seconds"])


def finished_by(result: Path) -> int:
    """Returns the attempt that finished a stage's result; 0 if none did, or its file is damaged."""
    try:
        return int(json.loads((result / _TIMES).read_text())["attempt"])
    except (OSError, ValueError, KeyError, TypeError):
        return 0


def checkpoint_folder(job: Job) -> Path:
    """Returns this attempt's checkpoint folder, initialized from the newest earlier attempt."""
    # Separate per attempt, because a suspended worker's trainer may resume writing.
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
    """Converts an exception to `OperationError` JSON, and logs its traceback."""
    with suppress(OSError):  # the log's disk may be full
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
    details = {
        "hint": "This is a defect of the server; its operator finds the trace in the log.",
        "log": log_name(job.operation_id),
    }
    return {
        "kind": Kind.INTERNAL.value, "reason": "INTERNAL", "message": message, "stage": stage, "details": details
    }  # fmt: skip


def disk_full_error() -> ResourceError:
    return ResourceError(
        "the disk is full", field="data_dir", hint="Free space in the server's data folder, then retry the operation."
    )


def error_to_json(error: FastSplatError, stage: str, **more: str) -> dict[str, Any]:
    """Converts an error to `OperationError` JSON."""
    return {
        "kind": error.kind.value,
        "reason": error.reason,
        "message": error.message,
        "stage": stage,
        "details": {**error.details(), **more},
        "recurs": error.recurs,
    }


def _blamed_photos(field: str, job: Job) -> list[str]:
    """Names the photo that an error's field refers to, directly or by its label map."""
    # Imported here because workers, which share this file, never read images.
    from fastsplat.service.capture.formats.upload_manifest import read_manifest

    try:
        manifest, _ = read_manifest(job.upload)
    except (OSError, ValueError, TypeError, KeyError, FastSplatError):  # a finished scene's folder, a damaged upload
        return []
    photos = zip(manifest.photos, manifest.names, strict=True)
    return [name for photo, name in photos if field in (name, photo.path, manifest.label_maps.get(photo.path))]


def log_name(operation_id: str) -> str:
    """Returns the name of a job's log in the data folder."""
    return f"logs/{operation_id}.log"
