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
    """An authenticated caller."""

    key_id: str  # "" if keys are off
    project: str
    role: Role
    scene_id: str = ""  # the only scene that the caller may see; "": all of the project


current_principal: ContextVar[Principal | None] = ContextVar("current_principal", default=None)
"""None for calls without authentication."""


def caller_id() -> str:
    """Returns the key id of the current call; "" without keys."""
    principal = current_principal.get()
    return principal.key_id if principal is not None else ""


def caller_project() -> str:
    """Returns the current call's project. Raises `UnauthenticatedError` for calls without authentication."""
    return _caller().project


def caller_role() -> Role:
    """Returns the caller's role. Raises `UnauthenticatedError` as `caller_project`."""
    return _caller().role


def in_callers_project(service: SceneService) -> SceneService:
    """Limits all calls to their caller's project and scene; no route can forget it."""
    return cast(SceneService, _InCallersProject(service)) if isinstance(service, SceneService) else service


class _InCallersProject:
    def __init__(self, service: SceneService) -> None:
        self._service = service

    def __getattr__(self, name: str) -> Any:
        caller = _caller()
        service = self._service.in_project(caller.project, caller.scene_id)
        return getattr(OneUpload(service, caller.key_id) if caller.role == "uploader" else service, name)


def _caller() -> Principal:
    principal = current_principal.get()
    if principal is None:
        raise UnauthenticatedError("this call has no caller", field="authorization")
    return principal
