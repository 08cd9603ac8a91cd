"""Settings of artefact storage."""

from __future__ import annotations

from pydantic import Field

from fastsplat.service.common.setting_groups import SettingGroup


class ArtefactSettings(SettingGroup, section="artefacts"):
    """An object store for machines that share no folder. Its credentials come from AWS_* variables and the like."""

    url: str = ""
    """Where uploads and scenes are stored, e.g. "s3://bucket/folder"; empty: inside data_dir."""
    endpoint_url: str = ""
    """Address of an S3-compatible store that is not Amazon's."""
    cache_bytes: int = Field(20 << 30, ge=0)
    """Size of this machine's copies of scenes; the least recently used are removed first."""
