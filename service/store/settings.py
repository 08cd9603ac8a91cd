"""Where artefacts are kept."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field


class ArtefactSettings(BaseModel):
    """An object store for machines that share no folder. Its credentials come from AWS_* variables and the like."""

    model_config = ConfigDict(frozen=True)

    url: str = Field("", description='uploads and scenes, e.g. "s3://bucket/folder"; empty: inside data_dir')
    endpoint_url: str = Field("", description="of an S3-compatible store that is not Amazon's")
    cache_bytes: int = Field(20 << 30, ge=0, description="this machine's copies of scenes; the least used leave first")
