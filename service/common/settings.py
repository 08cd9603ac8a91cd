"""Base class of every group of settings, and the names of the environment variables that set them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from difflib import get_close_matches
from typing import Any, ClassVar

from pydantic import BaseModel, ConfigDict, ValidationError

from fastsplat_contract.errors import InvalidInputError

ENV_PREFIX = "FASTSPLAT_"
ENV_DELIMITER = "__"
OTHER_VARIABLES = frozenset(
    ENV_PREFIX + name
    for name in (
        *("KEY", "SERVER"),  # the command, asking a server
        "BIND",  # Docker Compose
        *("RASTER_ISA", "RASTER_THREADS"),  # the kernels, in each process
        "PARENT_PID",  # a worker's trainer
        *("TEST_DATA", "TEST_SEED"),  # the tests
    )
)
"""Variables with our prefix that are no settings of the service."""

_SERVICE_LINK = re.compile(ENV_PREFIX + r"(\w+_)?(SERVICE_(HOST|PORT(_\w+)?)|PORT_\d+_(TCP|UDP)(_(PROTO|PORT|ADDR))?)")


class SettingGroup(BaseModel):
    """Base of one group of settings: frozen, without unknown fields, each field documented by the docstring under it.

    `class JobSettings(SettingGroup, section="jobs")` is the field `jobs` of `Settings`, so that users set its fields as
    FASTSPLAT_JOBS__MAX_STARTS and so on.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)

    section: ClassVar[str]

    def __init_subclass__(cls, *, section: str, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        cls.section = section


def environment_variable(group: type[BaseModel], field: str) -> str:
    """Name of the environment variable that sets a field, e.g. "FASTSPLAT_JOBS__MAX_STARTS".

    Args:
        group: a `SettingGroup` with a section, or the settings object of the whole service itself.
        field: one of its fields.

    Raises:
        AttributeError: it has no such field.
    """
    if field not in group.model_fields:
        raise AttributeError(f"{group.__name__} has no field {field!r}")
    return _variable((group.section, field) if issubclass(group, SettingGroup) else (field,))


def check_variables(variables: Mapping[str, str | None], settings: type[BaseModel]) -> None:
    """Check that every variable of ours names a setting, or its group, or belongs to another part of the product.

    Args:
        variables: the environment, names in lower case.
        settings: the settings object of the whole service.

    Raises:
        InvalidInputError: one does not; its hint has the name that is nearest.
    """
    known = {*_variables_of(settings, ()), *OTHER_VARIABLES}
    for name, value in variables.items():
        variable = name.upper()
        if variable.startswith(ENV_PREFIX) and variable not in known and not _is_service_link(variable, value or ""):
            raise _no_setting(variable, settings)


def settings_error(error: ValidationError, settings: type[BaseModel]) -> InvalidInputError:
    """The first problem of settings from the environment as an error that names the variable, without its value.

    Args:
        error: what validation says.
        settings: the settings object of the whole service.
    """
    first = error.errors(include_url=False, include_input=False, include_context=False)[0]
    variable = _variable([str(part) for part in first["loc"]])
    if first["type"] == "extra_forbidden":
        return _no_setting(variable, settings)
    return InvalidInputError(
        f"{variable} is not valid: {first['msg']}",
        field=variable,
        hint="Correct the variable, or unset it for the default.",
    )


def _no_setting(variable: str, settings: type[BaseModel]) -> InvalidInputError:
    names = [name.removeprefix(ENV_PREFIX) for name in (*_variables_of(settings, ()), *OTHER_VARIABLES)]
    near = get_close_matches(variable.removeprefix(ENV_PREFIX), names, n=1)
    guess = f"Did you mean {ENV_PREFIX}{near[0]}? " if near else ""
    return InvalidInputError(
        f"{variable} is no setting", field=variable, hint=f"{guess}Correct the variable, or unset it."
    )


def _variables_of(group: type[BaseModel], path: tuple[str, ...]) -> Iterator[str]:
    for name, field in group.model_fields.items():
        yield _variable((*path, name))
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
            yield from _variables_of(field.annotation, (*path, name))


def _is_service_link(variable: str, value: str) -> bool:
    """Whether Kubernetes or Docker set a variable for a service or a container that is called fastsplat itself."""
    return bool(_SERVICE_LINK.fullmatch(variable)) or value.startswith(("tcp://", "udp://"))


def _variable(path: Sequence[str]) -> str:
    return ENV_PREFIX + ENV_DELIMITER.join(path).upper()
