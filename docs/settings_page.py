"""Writes `settings.md`, all settings of the service with their defaults: `python -m docs.settings_page`."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from fastsplat.service.common.setting_groups import environment_variable, group_of, settings_of
from fastsplat.service.settings import Settings

PAGE = Path(__file__).with_name("settings.md")

_HEAD = """# Settings

Written by `python -m docs.settings_page` from the classes of the settings; a test says when it is out of date.

A setting is an environment variable of the server and of its workers. The same variable with `_FILE` behind its name
names a file that holds the value. A group can be one variable with a JSON object, such as
`FASTSPLAT_QUOTAS='{"scenes": 50}'`. A variable with our prefix that names no setting is refused when a process
starts."""

_UNITS = ((2**30, "GiB"), (2**20, "MiB"))


def settings_page() -> str:
    """Markdown of all settings, a table for each group."""
    single = {name: field for name, field in settings_of(Settings).items() if group_of(field) is None}
    parts = [_HEAD, "\n".join(["## The service", "", *_table(Settings, single)])]
    for name, field in settings_of(Settings).items():
        group = group_of(field)
        if group is not None:
            about = " ".join((group.__doc__ or "").split("\n\n")[0].split())
            parts.append("\n".join([f"## {name}", "", about, "", *_table(group, settings_of(group))]))
    return "\n\n".join(parts) + "\n"


def _table(group: type[BaseModel], fields: dict[str, FieldInfo]) -> Iterator[str]:
    yield "| variable | default | |"
    yield "|---|---|---|"
    for name, field in fields.items():
        about = " ".join((field.description or "").split()).replace("|", "\\|")
        yield f"| `{environment_variable(group, name)}` | {_default_text(name, field)} | {about} |"


def _default_text(name: str, field: FieldInfo) -> str:
    value: Any = field.default
    if field.default_factory is not None or value in ("", None, ()):
        return ""
    if isinstance(value, tuple):
        return ", ".join(f"`{entry}`" for entry in value)
    if name.endswith("bytes") and value:
        size, unit = next(((size, unit) for size, unit in _UNITS if value % size == 0), (1, "bytes"))
        return f"{value // size} {unit}"
    return f"`{value:g}`" if isinstance(value, float) else f"`{value}`"


if __name__ == "__main__":
    sys.exit(PAGE.write_text(settings_page()) == 0)
