"""The caller of the running task, or of the thread it started; and the service within the caller's project."""

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
    """The caller: key, project and role.

    Attributes:
        key_id: the key's; "" where keys are switched off.
        project: whose scenes the call is about.
        role: what the caller may do there.
        scene_id: the one scene that there is for the caller; "" for all of the project.
    """

    key_id: str
    project: str
    role: Role
    scene_id: str = ""


current_principal: ContextVar[Principal | None] = ContextVar("current_principal", default=None)
"""None where no key was asked for."""


def caller_id() -> str:
    """The id of the key behind the current call; "" without keys."""
    principal = current_principal.get()
    return principal.key_id if principal is not None else ""


def caller_project() -> str:
    """The project that the current call is about.

    Raises:
        UnauthenticatedError: nobody was asked for a key. Such a call must not reach any project's scenes.
    """
    return _caller().project


def caller_role() -> Role:
    """What the caller may do in that project. Raises `UnauthenticatedError`: as `caller_project`."""
    return _caller().role


def in_callers_project(service: SceneService) -> SceneService:
    """`service` as the caller's project has it, whoever calls: what both protocols serve, so that no route forgets it.

    Anything but a `SceneService` knows no projects, and is returned as it is.
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
