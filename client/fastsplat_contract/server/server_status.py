"""What a server can do, and how much room the caller's project has left."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Annotated, Literal

from pydantic import Field

from fastsplat_contract.codec.wire import Int64, Many, Response
from fastsplat_contract.jobs.name_suggestions import CaptionerStatus
from fastsplat_contract.server.keys import Role

ModelRole = Literal[
    "text_encoder", "closed_set_detector", "open_set_detector", "segmenter", "tagger", "lexicon", "reader", "image_text"
]
ModelState = Literal["ready", "missing", "unset"]
QuotaKind = Literal["scenes", "bytes", "jobs"]


@dataclass(frozen=True)
class ModelStatus(Response):
    """One model that the server's settings name, or could name."""

    role: Annotated[ModelRole, Field(description="what it is for")]
    name: Annotated[str, Field(description="as the settings name it; empty for none")]
    state: Annotated[
        ModelState, Field(description="ready: its files are there; missing: they are not; unset: no model is named")
    ]
    calibrated: Annotated[
        bool | None,
        Field(
            description="of a text encoder: whether its scores were measured, so that answers have probabilities; of a "
            "lexicon that is ready: whether it was measured together with the text encoder, so that answers use it; of "
            "an image-text model or open-set detector that is ready: whether it was measured, so that it names objects"
        ),
    ]


@dataclass(frozen=True)
class QuotaStatus(Response):
    """What the project uses of one quota."""

    kind: Annotated[QuotaKind, Field(description="scenes, bytes of their uploads, jobs that wait or run")]
    used: Int64
    limit: Annotated[Int64 | None, Field(description="absent: no bound")]


@dataclass(frozen=True)
class WorkerHealth(Response):
    """One worker that registered, alive or not: one that stopped by itself is none."""

    host: Annotated[str, Field(description="the machine that it runs on, as `fastsplat status --here` knows it")]
    pid: Annotated[int, Field(description="its process there")]
    silent_s: Annotated[float, Field(description="seconds since its last heartbeat")]
    alive: Annotated[bool, Field(description="whether that is recent enough for its jobs to be left to it")]


@dataclass(frozen=True)
class QueueHealth(Response):
    """Jobs of all projects."""

    waiting: Int64
    running: Int64
    waits_s: Annotated[
        float | None, Field(description="seconds for which the one that waits longest does; absent: none waits")
    ]


@dataclass(frozen=True)
class DiskHealth(Response):
    """The disk of the server's data folder."""

    total_bytes: Int64
    free_bytes: Int64
    floor_bytes: Annotated[Int64, Field(description="uploads are refused while less is free")]


@dataclass(frozen=True)
class ServerHealth(Response):
    """Whether there is somebody to do the jobs, room for them, and a queue that moves."""

    workers: Many[WorkerHealth]
    queue: QueueHealth
    disk: DiskHealth


@dataclass(frozen=True)
class ServerStatus(Response):
    """What a server can do, as the caller may know it."""

    version: Annotated[str, Field(description="the release that runs")]
    project: Annotated[str, Field(description="the one that the call is about")]
    role: Annotated[Role, Field(description="what the caller may do there")]
    key_expires_at: Annotated[datetime | None, Field(description="of the caller's key; absent: never, or no key")]
    asks_for_keys: Annotated[bool, Field(description="without, a link to one scene would hide nothing, and is refused")]
    upload_operation: Annotated[
        str, Field(description="of a key for one upload: the operation that it made; empty: none yet, or another role")
    ]
    models: Annotated[Many[ModelStatus], Field(description="empty for a key for one upload")]
    backend: Annotated[str, Field(description="what draws the answers: cpu, cuda or reference")]
    training_backend: Annotated[str, Field(description="what this server's workers train with: cpu, cuda or reference")]
    workers: Annotated[int, Field(description="worker processes that live; without one, jobs wait")]
    quotas: Annotated[Many[QuotaStatus], Field(description="of the project; empty for a key for one upload")]
    max_upload_bytes: Annotated[Int64, Field(description="of one upload, all its files together")]
    max_images: Annotated[int, Field(description="images in one upload")]
    addresses: Annotated[
        Many[str],
        Field(
            description="where other machines reach the web page, as far as the server knows; empty for readers, for a "
            "key for one upload, and for a server that listens on its own machine alone"
        ),
    ]
    captioner: Annotated[
        CaptionerStatus | None,
        Field(description="absent where the settings name none, for readers, and for keys that do one task"),
    ]
    health: Annotated[
        ServerHealth | None, Field(description="absent for everybody but operators: it tells of all projects")
    ]
