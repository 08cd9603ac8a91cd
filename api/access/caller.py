"""The caller of the running task or thread, and the service within the caller's project."""

from __future__ import annotations

from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any, cast

from fastsplat.service.application.service import SceneService
from fastsplat.service.application.upload_keys import OneUpload
from fastsplat_contract.errors import UnauthenticatedError
from fastsplat_contract.server.keys import Role


@dataclass(frozen=True)
class Principal:
    """An authenticated caller.

    Attributes:
        key_id: "" if keys are off.
        project: the project of the call.
        role: the caller's role in it.
        scene_id: the only scene that the caller may see; "" for all of the project.
    """

    key_id: str
    project: str
    role: Role
    scene_id: str = ""


current_principal: ContextVar[Principal | None] = ContextVar("current_principal", default=None)
"""None for calls without authentication."""


def caller_id() -> str:
    """Returns the key id of the current call; "" without keys."""
    principal = current_principal.get()
    return principal.key_id if principal is not None else ""


def caller_project() -> str:
    """Returns the project of the current call.

    Raises:
        UnauthenticatedError: the call was not authenticated, so it must not reach any project's scenes.
    """
    return _caller().project


def caller_role() -> Role:
    """Returns the caller's role. Raises `UnauthenticatedError` as `caller_project`."""
    return _caller().role


def in_callers_project(service: SceneService) -> SceneService:
    """Wraps the service so that every call is limited to its caller's project and scene.

    Both protocols serve the wrapper, so that no route can forget it. Only a `SceneService` is wrapped.
    """
    return cast(SceneService, _InCallersProject(service)) if isinstance(service, SceneService) else service


class _InCallersProject:
    def __init__(self, service: SceneService) -> None:
        self._service = service

    def __getattr__(self, name: str) -> Any:
        caller = _caller()
        own = self._service.in_project(caller.project, caller.scene_id)
        return getattr(OneUpload(own, caller.key_id) if caller.role == "uploader" else own, name)


def _caller() -> Principal:
    principal = current_principal.get()
    if principal is None:
        raise UnauthenticatedError("this call has no caller", field="authorization")
    return principal
