"""Base classes of settings and the environment variables that set them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from difflib import get_close_matches
from typing import Any, ClassVar

from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic.fields import FieldInfo

from fastsplat_contract.errors import InvalidInputError

ModelChoice = Mapping[str, Mapping[str, Any]]
"""By role, the model that is used unless a setting names one: "name" as in a setting, "sha256" by file."""

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
"""Variables with `ENV_PREFIX` that are not settings of the service."""

_SERVICE_LINK = re.compile(ENV_PREFIX + r"(\w+_)?(SERVICE_(HOST|PORT(_\w+)?)|PORT_\d+_(TCP|UDP)(_(PROTO|PORT|ADDR))?)")


class Options(BaseModel):
    """Base of a stage's options: frozen, no unknown fields, field docstrings as descriptions.

    Fields are constants of the product: the environment cannot set them, but tests and benchmarks pass other values.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)


class SettingGroup(Options):
    """Base of a group of settings.

    `class JobSettings(JobOptions, SettingGroup, section="jobs")` is the field `jobs` of `Settings`; users set its own
    fields as FASTSPLAT_JOBS__MAX_STARTS etc. Fields inherited from `JobOptions` are constants.
    """

    section: ClassVar[str]

    def __init_subclass__(cls, *, section: str, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        cls.section = section


def environment_variable(group: type[BaseModel], field: str) -> str:
    """Names the variable that sets a field, e.g. "FASTSPLAT_JOBS__MAX_STARTS".

    Raises:
        AttributeError: the group has no such setting.
    """
    if field not in settings_of(group):
        raise AttributeError(f"{group.__name__} has no setting {field!r}")
    return _variable((group.section, field) if issubclass(group, SettingGroup) else (field,))


def settings_of(group: type[BaseModel]) -> dict[str, FieldInfo]:
    """Returns a group's fields that the environment may set."""
    options = [base for base in group.__mro__[1:] if issubclass(base, Options) and not issubclass(base, SettingGroup)]
    constants = {name for base in options for name in base.model_fields}
    constants |= {name for name, field in group.model_fields.items() if _is_constant(field)}
    return {name: field for name, field in group.model_fields.items() if name not in constants}


def _is_constant(field: FieldInfo) -> bool:
    kind = field.annotation
    return isinstance(kind, type) and issubclass(kind, Options) and not issubclass(kind, SettingGroup)


def group_of(field: FieldInfo) -> type[SettingGroup] | None:
    """Returns the settings group that a field holds, or None."""
    group = field.annotation
    return group if isinstance(group, type) and issubclass(group, SettingGroup) else None


def check_variables(variables: Mapping[str, str | None], settings: type[BaseModel]) -> None:
    """Checks that every variable with our prefix is known; names are lower-case.

    Raises:
        InvalidInputError: an unknown variable; the hint suggests the closest name.
    """
    known = {*_variables_of(settings), *OTHER_VARIABLES}
    for name, value in variables.items():
        variable = name.upper()
        if variable.startswith(ENV_PREFIX) and variable not in known and not _is_service_link(variable, value or ""):
            raise _no_setting(variable, settings)


def check_groups(values: Mapping[str, Any], settings: type[BaseModel]) -> None:
    """Checks that groups set as JSON objects contain only settings.

    Raises:
        InvalidInputError: an unknown field; the hint suggests the closest name.
    """
    for name, field in settings_of(settings).items():
        group, given = group_of(field), values.get(name)
        if group is not None and isinstance(given, Mapping):
            for unknown in given.keys() - settings_of(group).keys():
                raise _no_setting(_variable((name, unknown)), settings)


def settings_error(error: ValidationError, settings: type[BaseModel]) -> InvalidInputError:
    """Converts the first validation error, naming the variable without its value."""
    first = error.errors(include_url=False, include_input=False, include_context=False)[0]
    variable = _variable([str(part) for part in first["loc"]])
    if first["type"] == "extra_forbidden":
        return _no_setting(variable, settings)
    return InvalidInputError.of(
        variable, f"is not valid: {first['msg']}", "Correct the variable, or unset it for the default."
    )


def _no_setting(variable: str, settings: type[BaseModel]) -> InvalidInputError:
    names = [name.removeprefix(ENV_PREFIX) for name in (*_variables_of(settings), *OTHER_VARIABLES)]
    near = get_close_matches(variable.removeprefix(ENV_PREFIX), names, n=1)
    guess = f"Did you mean {ENV_PREFIX}{near[0]}? " if near else ""
    return InvalidInputError.of(variable, "is no setting", f"{guess}Correct the variable, or unset it.")


def _variables_of(settings: type[BaseModel]) -> Iterator[str]:
    for name, field in settings_of(settings).items():
        yield _variable((name,))
        group = group_of(field)
        if group is not None:
            yield from (_variable((name, inner)) for inner in settings_of(group))


def _is_service_link(variable: str, value: str) -> bool:
    """Recognizes variables that Kubernetes or Docker set for services called fastsplat."""
    return bool(_SERVICE_LINK.fullmatch(variable)) or value.startswith(("tcp://", "udp://"))


def _variable(path: Sequence[str]) -> str:
    return ENV_PREFIX + ENV_DELIMITER.join(path).upper()
