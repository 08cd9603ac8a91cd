"""Errors of scene folders."""

from __future__ import annotations

from fastsplat.service.common.errors import FastSplatError, Kind


class SceneFileError(FastSplatError):
    """A scene folder on this server is damaged: a file is missing, cut short, altered, or contradicts another."""

    kind = Kind.INTERNAL
    reason = "SCENE_DAMAGED"


class SceneSchemaError(SceneFileError):
    """A scene folder was written by a version of this software whose schema this one does not know."""

    kind = Kind.FAILED_PRECONDITION
    reason = "SCENE_SCHEMA"
