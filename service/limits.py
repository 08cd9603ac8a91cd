"""What one caller, and all of them together, may ask of the service."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field


class LimitSettings(BaseModel):
    """Requests at a time and over time. What passes them is refused at once, with the time to wait."""

    model_config = ConfigDict(frozen=True)

    rate_per_s: float = Field(1_000.0, gt=0, description="requests a second of one key, over time")
    burst: int = Field(2_000, ge=1, description="requests of one key at once after a pause")
    in_flight: int = Field(64, ge=1, description="requests of one key under way, standing ones included")
    uploads: int = Field(4, ge=1, description="uploads of one key under way; all keys share eight threads for them")
    admitted: int = Field(96, ge=1, description="requests of all keys that compute or wait for a thread")
    threads: int = Field(0, ge=0, description="threads that answer requests; 0: two a core, at least four")


class QuotaSettings(BaseModel):
    """What one key may hold. 0: no bound."""

    model_config = ConfigDict(frozen=True)

    scenes: int = Field(0, ge=0, description="scenes")
    stored_bytes: int = Field(0, ge=0, description="bytes of uploads whose scenes exist, and of unfinished uploads")
    queued_jobs: int = Field(0, ge=0, description="jobs that are queued or run")
