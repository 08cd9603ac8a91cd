"""What those ask who run a server: its projects, and what the trainers of a job wrote."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Annotated, NamedTuple

from pydantic import Field

from fastsplat_contract.codec.wire import Many, Request, Response, travels
from fastsplat_contract.messages.requests import OfOperation


@dataclass(frozen=True)
class CreateProjectRequest(Request):
    """A new project, empty and without keys."""

    name: Annotated[str, Field(description="1 to 63 lower-case letters, digits and hyphens, no hyphen first")]


@dataclass(frozen=True)
class Project(Response):
    """A project: what is in it does not exist for the keys of another."""

    name: str
    created_at: datetime
    scenes: Annotated[int, Field(description="in whatever state")]
    keys: Annotated[int, Field(description="revoked and expired ones, too")]


@travels(request=False, proto="ListProjectsResponse")
class ProjectList(NamedTuple):
    """Every project, by name."""

    projects: Many[Project]


@dataclass(frozen=True)
class GetJobLogRequest(Request, OfOperation):
    """Of which job."""


@dataclass(frozen=True)
class JobLog(Response):
    """The end of what the trainers of a job wrote."""

    log: Annotated[str, Field(description="the last MiB at most")]
