"""Messages between a supervisor and its trainer, one JSON object a line: a job to the trainer, events from it."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from fastsplat.service.common.progress import Progress, ProgressEvent
from fastsplat.service.settings import Settings
from fastsplat_contract.json_codec import from_plain, to_plain
from fastsplat_contract.operations import SceneOptions


@dataclass(frozen=True)
class Job:
    """What a trainer runs.

    Attributes:
        operation_id: whose job this is.
        attempt: counts the trainers of this job; part of the name of everything unfinished.
        upload: the validated upload's folder; of a job on a finished scene, the folder of its current version.
        folder: the job's work folder, shared by all attempts.
        options: the user's choices.
        settings: the operator's, with what the user chose.
        stages: names of its stages, in order.
        order: of a job on a finished scene: what was ordered, as JSON.
        version: of a job on a finished scene: whose folder `upload` is.
        exclude: paths of photos in the upload that are left out.
    """

    operation_id: str
    attempt: int
    upload: Path
    folder: Path
    options: SceneOptions
    settings: Settings
    stages: tuple[str, ...] = ()
    order: Mapping[str, Any] = field(default_factory=dict)
    version: str = ""
    exclude: tuple[str, ...] = ()

    def result(self, stage: str) -> Path:
        """Folder of a stage's finished result; if it exists, it is complete."""
        return self.folder / stage

    @property
    def finish_mark(self) -> Path:
        """File that is there once the job is to end its training early, for all attempts."""
        return self.folder / "finish"

    def to_line(self, run: str, *, asks_namer: bool = False) -> bytes:
        """The first line that a trainer reads; the database's URL is left out, as it may hold a password.

        Args:
            run: what runs the stages, see `JobKind.run`.
            asks_namer: whether it is told of the settings' namer.
        """
        secret = {"database_url", "database_password", *(() if asks_namer else ("namer",))}
        spec = {
            "operation_id": self.operation_id,
            "attempt": self.attempt,
            "upload": str(self.upload),
            "folder": str(self.folder),
            "options": to_plain(self.options),
            "settings": self.settings.model_dump(mode="json", exclude=secret),
            "stages": self.stages,
            "order": dict(self.order),
            "version": self.version,
            "exclude": self.exclude,
            "run": run,
        }
        return json.dumps(spec).encode() + b"\n"


def read_job(line: bytes) -> tuple[Job, str]:
    """Back from `Job.to_line`, with what runs the stages."""
    spec = json.loads(line)
    job = Job(
        operation_id=spec["operation_id"],
        attempt=spec["attempt"],
        upload=Path(spec["upload"]),
        folder=Path(spec["folder"]),
        options=from_plain(SceneOptions, spec["options"]),
        settings=Settings(**spec["settings"]),
        stages=tuple(spec["stages"]),
        order=spec["order"],
        version=spec["version"],
        exclude=tuple(spec["exclude"]),
    )
    return job, spec["run"]


Stage = Callable[[Job, Path, Progress], None]
"""Reads earlier results through `Job.result`, writes its own into the folder, reports progress."""


@dataclass(frozen=True)
class Done:
    """A stage's result is complete in the work folder; `seconds` is what it took, 0.0 if it was there before."""

    stage: str
    seconds: float


@dataclass(frozen=True)
class Failed:
    """A stage ended with an error: an `OperationError` as JSON."""

    error: Mapping[str, Any]


Event = ProgressEvent | Done | Failed


def event_to_line(event: Event) -> bytes:
    """One line for the pipe."""
    kind = {ProgressEvent: "progress", Done: "done", Failed: "failed"}[type(event)]
    return json.dumps({kind: asdict(event)}, default=float).encode() + b"\n"


def read_event(line: bytes) -> Event:
    """Back from `event_to_line`."""
    ((kind, values),) = json.loads(line).items()
    if kind == "done":
        return Done(**values)
    return Failed(**values) if kind == "failed" else ProgressEvent(**values)
