"""Choices of the service layer."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field


class CallSettings(BaseModel):
    """What an answer may hold, and how much is kept in memory between answers."""

    model_config = ConfigDict(frozen=True)

    scene_memory_bytes: int = Field(
        4 << 30, ge=1, description="open scenes are kept up to this, least recently used leave first"
    )
    max_matches: int = Field(100, ge=1, description="entries an answer ranks where the request does not say how many")
    max_listed: int = Field(5_000, ge=1, description="labels and cameras of a scene that are told in one piece")
    max_versions: int = Field(50, ge=2, description="versions of one scene")
    max_edits: int = Field(100, ge=1, description="edits in one request")
    heartbeat_s: float = Field(5.0, gt=0, description="a standing question says that it lives after so long a silence")
