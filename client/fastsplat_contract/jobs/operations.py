"""Jobs that make a scene, or do something to one: ordered, under way, ended."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from typing import Annotated, ClassVar, Literal, NamedTuple

from pydantic import Field

from fastsplat_contract.codec.wire import Int64, Many, Request, Response, travels
from fastsplat_contract.jobs.job_watching import CreateSceneResult, DraftInfo, PlacedInfo, PreviewInfo, WorkerState
from fastsplat_contract.jobs.look_again import LookAgainResult
from fastsplat_contract.jobs.name_suggestions import CaptionerResult

OperationState = Literal["QUEUED", "RUNNING", "SUCCEEDED", "FAILED", "CANCELLED"]
FINAL_STATES: tuple[OperationState, ...] = ("SUCCEEDED", "FAILED", "CANCELLED")
"""After these nothing changes any more."""

OperationKind = Literal["create_scene", "look_again", "ask_captioner"]
"""What a job does."""

RESULTS: Mapping[OperationKind, type[Response]] = {
    "create_scene": CreateSceneResult, "look_again": LookAgainResult, "ask_captioner": CaptionerResult,
}  # fmt: skip
"""What comes of a job beside its version, in the field of `Operation` that is named like the kind."""

AgainAfter = Literal["cancelled", "failed", "worker_stopped", "worker_died", "trainer_died"]
"""What ended the attempt before."""

PresetName = Literal["draft", "balanced", "best"]

UpAxis = Literal["x", "-x", "y", "-y", "z", "-z"]
Movers = Literal["keep", "ignore"]
Privacy = Literal["people"]
"""Which axis of a splat's world points up."""

Lens = Literal["auto", "fisheye", "panorama"]
"""What photos and videos without poses were taken with."""

MAX_PRIORITY = 100
MAX_NADIR_DEG = 80.0
MIN_TOLERANCE_DB, MAX_TOLERANCE_DB = 0.05, 2.0


@dataclass(frozen=True)
class SceneOptions(Request):
    """What a user may choose when posting a scene."""

    proto: ClassVar[str] = "CreateSceneHeader"

    labels: Annotated[
        Many[str],
        Field(description="names to look for (in a form repeated, or separated by commas); empty: the server decides"),
    ] = ()
    time_budget_s: Annotated[
        float | None,
        Field(
            gt=0,
            description="seconds for everything after the capture stage; absent: no bound on the whole. The scene's "
            "quality says what was given up for it",
        ),
    ] = None
    max_gaussians: Annotated[Int64 | None, Field(ge=1, description="hard budget; absent: the server's default")] = None
    preset: Annotated[PresetName | None, Field(description="draft, balanced or best; absent: the server's default")] = (
        None
    )
    tolerance_db: Annotated[
        float | None,
        Field(
            ge=MIN_TOLERANCE_DB,
            le=MAX_TOLERANCE_DB,
            description="in place of a preset: PSNR of photos held out, dB, that twice the training may still gain; "
            "draft is 0.8, balanced 0.3, best 0.1",
        ),
    ] = None
    priority: Annotated[
        int, Field(ge=-MAX_PRIORITY, le=MAX_PRIORITY, description="higher ones are trained first; 0 is usual")
    ] = 0
    up: Annotated[
        UpAxis | None,
        Field(
            description="for a splat without posed photos: which axis of its world is up, so that pictures of it stand "
            "upright: x, -x, y, -y, z or -z; absent: estimated"
        ),
    ] = None
    movers: Annotated[
        Movers | None,
        Field(
            description="what moves in the photos. ignore: people, cats and dogs, by the detector's word, enter no "
            "matching, no training and no label, even if they keep still; keep, and absent: everything is used"
        ),
    ] = None
    privacy: Annotated[
        Privacy | None,
        Field(
            description="people: a promise. Pixels that show people, by the detector's word, enter no feature, no "
            "training, no label and no stored image, and the files as sent are deleted once the photos are read"
        ),
    ] = None
    lens: Annotated[
        Lens | None,
        Field(
            description="of photos or a video without poses: fisheye, or panorama (equirectangular, 360° by 180°); "
            "auto: panoramas are known by their metadata, all others are perspective; absent: the server's default"
        ),
    ] = None
    nadir_deg: Annotated[
        float | None,
        Field(
            ge=0,
            le=MAX_NADIR_DEG,
            description="of panoramas: pixels within so many degrees of straight down, where the photographer stands, "
            "are left out; absent: the server's default",
        ),
    ] = None
    strict: Annotated[
        bool,
        Field(
            description="refuse the upload where one of its photos or frames cannot be used; else these are left out, "
            "and named in left_out"
        ),
    ] = False


@dataclass(frozen=True)
class StageProgress(Response):
    """One stage of a job."""

    stage: Annotated[
        str,
        Field(
            description="capture, perception, training or export; looking or naming where a scene is looked at "
            "again; asking or suggesting where the server's captioner is asked"
        ),
    ]
    fraction: Annotated[float, Field(description="0..1 of this stage")]
    message: Annotated[str, Field(description="a short line for people")]
    seconds: Annotated[float, Field(description="spent in this stage")]
    metrics: Mapping[str, float]


@dataclass(frozen=True)
class OperationError(Response):
    """Why a job failed."""

    kind: Annotated[str, Field(description="name of a google.rpc.Code")]
    reason: Annotated[str, Field(description="stable across releases")]
    message: str
    stage: Annotated[str, Field(description="the stage that failed")]
    details: Annotated[Mapping[str, str], Field(description="any of field, limit, hint")]
    photos: Annotated[
        Many[str],
        Field(
            description="names of the photos that are to blame, as a retry may exclude them; empty: none in particular"
        ),
    ] = ()
    recurs: Annotated[
        bool,
        Field(
            description="whether the same photos with the same options end like this again: then a retry helps only "
            "if it excludes what is to blame"
        ),
    ] = False


@dataclass(frozen=True)
class JobAttempt(Response):
    """One run of a job by a worker."""

    number: int
    worker: Annotated[str, Field(description="end of the worker's name, as its log says it")]
    began_at: datetime
    ended_at: Annotated[datetime | None, Field(description="absent while it runs")]
    why: Annotated[AgainAfter | None, Field(description="why it ended; absent while it runs, and after success")]


@dataclass(frozen=True)
class Operation(Response):
    """One job (AIP-151), durable from the moment it is returned."""

    id: str
    scene_id: str
    state: OperationState
    done: Annotated[bool, Field(description="whether the state is final")]
    created_at: datetime
    updated_at: datetime
    stages: Annotated[Many[StageProgress], Field(description="those begun so far, in order")]
    error: Annotated[OperationError | None, Field(description="absent unless it failed")]
    kind: Annotated[
        OperationKind,
        Field(
            description="create_scene: makes its scene; look_again: makes a version of its scene; "
            "ask_captioner: the same where the server's captioner suggests a name"
        ),
    ] = "create_scene"
    look_again: Annotated[
        LookAgainResult | None, Field(description="what looking again found; absent unless it has succeeded")
    ] = None
    ask_captioner: Annotated[
        CaptionerResult | None, Field(description="what the server's captioner said; absent unless it has succeeded")
    ] = None
    attempt: Annotated[int, Field(description="how often it was begun")] = 0
    worker: Annotated[
        WorkerState | None,
        Field(
            description="none: no worker of the server runs; waiting: it waits for its turn; working; silent: its "
            "worker has not been heard from for long, and another will go on with it; absent once it is done"
        ),
    ] = None
    seconds_left: Annotated[
        float | None,
        Field(description="until the whole job is done, as estimated with its last progress; absent while unknown"),
    ] = None
    jobs_ahead: Annotated[
        int | None, Field(description="under way, or before it in the queue; absent unless it is queued")
    ] = None
    starts_in_s: Annotated[
        float | None,
        Field(description="until a worker is free for it, about, as far as jobs ahead are predicted; absent: unknown"),
    ] = None
    finish_requested: Annotated[
        bool, Field(description="whether its training was asked to stop early and keep what is there")
    ] = False
    preview: Annotated[
        PreviewInfo | None, Field(description="the newest picture of its training; absent if there is none (any more)")
    ] = None
    placed: Annotated[
        PlacedInfo | None, Field(description="the cameras that can be looked at; absent if there are none (any more)")
    ] = None
    draft: Annotated[
        DraftInfo | None, Field(description="the newest draft of its scene; absent without one, and once it is done")
    ] = None
    create_scene: Annotated[
        CreateSceneResult | None,
        Field(description="what became of edits of drafts; absent without them, and until it has succeeded"),
    ] = None
    again_after: Annotated[
        AgainAfter | None,
        Field(
            description="why its newest attempt is not its first. cancelled, failed: it had ended so, and was retried; "
            "worker_stopped: its worker was told to stop; worker_died, trainer_died: they stopped without warning. "
            "After these three it goes on where it was. Absent in the first attempt"
        ),
    ] = None
    attempts: Annotated[Many[JobAttempt], Field(description="oldest first")] = ()
    left_out: Annotated[
        Mapping[str, str],
        Field(
            description="why files of the upload cannot be used, by their names in it; of very many the first, the "
            "scene's quality has all"
        ),
    ] = field(default_factory=dict)


@dataclass(frozen=True)
class JobEstimate(Response):
    """How long a job would take on the server's machine, from the moment a worker takes it."""

    seconds: Annotated[float, Field(description="the whole job")]
    stages: Annotated[
        Mapping[str, float], Field(description="seconds of each stage: capture, perception, training, export")
    ]


@dataclass(frozen=True)
class RetryIn(Request):
    """How a failed or cancelled job is tried again."""

    proto: ClassVar[str] = "RetryOperationRequest"

    exclude: Annotated[
        Many[str],
        Field(
            description="photos of its upload to leave out, by their paths in it or by the names that errors and "
            "verdicts call them, beside those of earlier retries"
        ),
    ] = ()


@travels(request=False, proto="ListOperationsResponse")
class OperationList(NamedTuple):
    """One page of operations (AIP-158), newest first."""

    operations: Many[Operation]
    next_page_token: Annotated[str, Field(description="empty on the last page")]
