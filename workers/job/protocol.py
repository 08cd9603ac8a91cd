"""JSON-lines protocol between supervisor and trainer: a job in, events out."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from fastsplat.service.common.progress import Progress, ProgressEvent
from fastsplat.service.settings import Settings
from fastsplat_contract.codec.json_codec import from_plain, to_plain
from fastsplat_contract.jobs.operations import SceneOptions


@dataclass(frozen=True)
class Job:
    """A trainer's job."""

    operation_id: str
    attempt: int  # counts the job's trainers; part of the names of unfinished files
    upload: Path  # validated upload, or the finished scene's current version
    folder: Path  # work folder, shared by all attempts
    options: SceneOptions
    settings: Settings  # the operator's, with the user's choices
    stages: tuple[str, ...] = ()
    order: Mapping[str, Any] = field(default_factory=dict)  # of a job on a finished scene, as JSON
    version: str = ""  # of a finished scene, in `upload`
    exclude: tuple[str, ...] = ()  # upload paths of photos to leave out

    def result(self, stage: str) -> Path:
        """Folder of a stage's result; complete if it exists."""
        return self.folder / stage

    @property
    def finish_mark(self) -> Path:
        """File whose existence requests an early end of training, for all attempts."""
        return self.folder / "finish"

    def to_line(self, run: str, *, asks_captioner: bool = False) -> bytes:
        """Encodes the trainer's first input line, without database credentials."""
        secret = {"database_url", "database_password", *(() if asks_captioner else ("captioner",))}
        settings = self.settings.model_dump(mode="json", exclude=secret)
        spec = {**vars(self), "options": to_plain(self.options), "settings": settings, "order": dict(self.order)}
        return json.dumps({**spec, "run": run}, default=os.fspath).encode() + b"\n"


def read_job(line: bytes) -> tuple[Job, str]:
    """Decodes `Job.to_line`; returns also `run`."""
    spec = json.loads(line)
    run = spec.pop("run")
    options, settings = from_plain(SceneOptions, spec.pop("options")), Settings(**spec.pop("settings"))
    paths: dict[str, Any] = {name: Path(spec.pop(name)) for name in ("upload", "folder")}
    lists: dict[str, Any] = {name: tuple(spec.pop(name)) for name in ("stages", "exclude")}
    return Job(**spec, **paths, **lists, options=options, settings=settings), run


Stage = Callable[[Job, Path, Progress], None]
"""Reads earlier results through `Job.result`, writes its own into the folder, reports progress."""


@dataclass(frozen=True)
class Done:
    """A stage is complete; `seconds` is 0.0 if it was before."""

    stage: str
    seconds: float


@dataclass(frozen=True)
class Failed:
    """A stage failed with an `OperationError` as JSON."""

    error: Mapping[str, Any]


Event = ProgressEvent | Done | Failed


def event_to_line(event: Event) -> bytes:
    kind = {ProgressEvent: "progress", Done: "done", Failed: "failed"}[type(event)]
    return json.dumps({kind: asdict(event)}, default=float).encode() + b"\n"


def read_event(line: bytes) -> Event:
    """Decodes `event_to_line`."""
    ((kind, values),) = json.loads(line).items()
    if kind == "done":
        return Done(**values)
    return Failed(**values) if kind == "failed" else ProgressEvent(**values)
