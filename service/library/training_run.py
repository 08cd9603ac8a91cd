"""Trains a scene into a folder, running the service's job in its own worker process."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.common.file_names import is_system_file
from fastsplat.service.common.process import PARENT_VARIABLE
from fastsplat.service.library.job_lines import ProgressLines
from fastsplat.service.library.local_scene import LocalScene, folder_settings, newest_scene
from fastsplat_contract.errors import ConflictError, NotFoundError, NotReadyError, ResourceError
from fastsplat_contract.jobs.operations import Operation, PresetName, SceneOptions

_POLL_S = 0.3
_STOP_S = 40.0
_LOG = "worker.log"
_ELSEWHERE = ("FASTSPLAT_DATABASE_URL", "FASTSPLAT_DATABASE_PASSWORD_FILE", "FASTSPLAT_ARTEFACTS__")
"""Server settings that the worker must not inherit: training stays in its folder."""


def train(
    capture: str | Path,
    out: str | Path | None = None,
    *,
    name: str = "",
    labels: Sequence[str] = (),
    seconds: float | None = None,
    preset: PresetName | None = None,
    tolerance_db: float | None = None,
    max_gaussians: int | None = None,
    strict: bool = False,
    progress: Callable[[Operation], None] | None = None,
) -> LocalScene:
    """Trains a scene and opens it.

    Args:
        capture: a folder of photos (with poses, masks or label maps, see the documentation of captures), a zip, or a
            video.
        out: output folder; default "<capture>-scene" in the working directory. Unfinished training in it is deleted.
        name: display name; default the capture's.
        labels: names to look for; default those of the configured detectors.
        seconds: time budget for everything after structure from motion; default the preset's.
        preset: draft, balanced or best.
        tolerance_db: in place of a preset, what twice the training may still gain, 0.05 to 2 dB of PSNR.
        max_gaussians: hard limit.
        strict: reject the capture if a photo is unusable; otherwise the photo is left out and the operation lists it.
        progress: called on every change of the operation; default `ProgressLines`.

    Raises:
        ConflictError: the folder has a trained scene.
        NotFoundError: the capture does not exist.
        NotReadyError: the job failed; gives the reason.
        ResourceError: the worker exited; the message has the end of its log.
        FastSplatError: the service rejected the photos.
    """
    source = Path(capture)
    if not source.exists():
        raise NotFoundError(f"there is no {source}", field="capture", hint="Name a folder of photos, a zip or a video.")
    folder = Path(f"{source.resolve().stem}-scene") if out is None else Path(out)
    options = SceneOptions(tuple(labels), seconds, max_gaussians, preset, tolerance_db=tolerance_db, strict=strict)
    service = open_service(folder_settings(folder))
    try:
        _make_room(service, folder)
        operation = _post(service, source, name or source.resolve().stem, options)
        try:
            with _worker(folder) as process:
                operation = _followed(service, operation, process, folder, progress or ProgressLines())
        except BaseException:
            if not service.get_operation(operation.id).done:
                service.cancel_operation(operation.id)  # an interrupted job must not resume later
            raise
        if operation.state != "SUCCEEDED":
            error = operation.error
            raise NotReadyError(
                f"the job ended as {operation.state}" + (f": {error.reason}: {error.message}" if error else ""),
                field="capture",
                hint=error.details.get("hint", "") if error else "",
            )
        return LocalScene(service, operation.scene_id)
    except BaseException:
        service.close()
        raise


def _make_room(service: SceneService, folder: Path) -> None:
    while (scene := newest_scene(service)) is not None:
        if scene.state == "READY":
            raise ConflictError(
                f"{folder} has a trained scene", field="out", hint="Open it with open_scene, or name another folder."
            )
        if scene.state == "TRAINING":
            service.cancel_operation(scene.operation_id)
        service.delete_scene(scene.id)


def _post(service: SceneService, source: Path, name: str, options: SceneOptions) -> Operation:
    with service.new_upload() as upload:
        files = [source] if source.is_file() else sorted(path for path in source.rglob("*") if path.is_file())
        for path in files:
            subpath = path.relative_to(source.parent if source.is_file() else source)
            if not is_system_file(subpath.parts):
                with path.open("rb") as stream:
                    upload.write(subpath.as_posix(), stream)
        return service.create_scene(upload, name, "", options)


@contextmanager
def _worker(folder: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Runs a worker for the folder."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith(_ELSEWHERE)}
    environment["FASTSPLAT_DATA_DIR"] = str(folder.resolve())
    with running_command("worker", environment, folder / _LOG) as process:
        yield process


@contextmanager
def running_command(word: str, environment: Mapping[str, str], log: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Runs a command of `fastsplat`, which ends with the block or with this process."""
    with log.open("ab") as sink:
        # A session of its own, so that whatever it starts can be stopped with it.
        process = subprocess.Popen(
            [sys.executable, "-m", "fastsplat.cli.main", word],
            env={**environment, PARENT_VARIABLE: str(os.getpid())},
            stdin=subprocess.DEVNULL,
            stdout=sink,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    try:
        yield process
    finally:
        process.terminate()
        try:
            process.wait(_STOP_S)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def _followed(
    service: SceneService,
    operation: Operation,
    process: subprocess.Popen[bytes],
    folder: Path,
    progress: Callable[[Operation], None],
) -> Operation:
    while not operation.done:
        if process.poll() is not None:
            tail = (folder / _LOG).read_text(errors="replace")[-2000:]
            raise ResourceError(f"the worker ended with {process.returncode}:\n{tail}", field="capture")
        time.sleep(_POLL_S)
        earlier, operation = operation, service.get_operation(operation.id)
        if operation != earlier:
            progress(operation)
    return operation
