"""Base class of every group of settings, and the names of the environment variables that set them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

from pydantic import BaseModel, ConfigDict, ValidationError

from fastsplat_contract.errors import InvalidInputError

ENV_PREFIX = "FASTSPLAT_"
ENV_DELIMITER = "__"


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


def settings_error(error: ValidationError) -> InvalidInputError:
    """The first problem of settings from the environment as an error that names the variable, without its value."""
    first = error.errors(include_url=False, include_input=False, include_context=False)[0]
    variable = _variable([str(part) for part in first["loc"]])
    problem = "is no setting" if first["type"] == "extra_forbidden" else f"is not valid: {first['msg']}"
    return InvalidInputError(
        f"{variable} {problem}", field=variable, hint="Correct the variable, or unset it for the default."
    )


def _variable(path: Sequence[str]) -> str:
    return ENV_PREFIX + ENV_DELIMITER.join(path).upper()
