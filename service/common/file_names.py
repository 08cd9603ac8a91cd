"""Validates and lists file names supplied by clients."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable, Sequence
from pathlib import PurePosixPath

from fastsplat_contract.errors import InvalidInputError

_MAX_DEPTH = 16
_MAX_NAME_BYTES = 255
_SHOWN_LETTERS = 80
_SHOWN_NAMES = 5
_SYSTEM_FILES = frozenset({"__MACOSX", "Thumbs.db", "desktop.ini"})


def safe_parts(name: str) -> tuple[str, ...]:
    """Splits a relative file name that is safe to write below a folder, dropping ".".

    Raises:
        InvalidInputError: absolute, empty, longer than 255 bytes a part or deeper than 16 parts, or with "..", a
            backslash, a drive letter, control characters or bytes that are not text.
    """
    parts = PurePosixPath(name).parts
    problem = _problem(name, parts)
    if problem:
        raise InvalidInputError(
            f"the file name {name[:_SHOWN_LETTERS]!r} is not safe: it {problem}",
            field="files",
            hint="Use relative names with forward slashes, without '..' and control characters.",
        )
    return parts


def is_system_file(parts: tuple[str, ...]) -> bool:
    """Tests for hidden files and files written by operating systems."""
    return any(part in _SYSTEM_FILES or part.startswith(".") for part in parts)


def common_folder(paths: Iterable[str]) -> str:
    """Returns the deepest common folder of relative paths; "." for their root."""
    folders = [PurePosixPath(path).parts[:-1] for path in paths]
    shared = []
    for column in zip(*folders, strict=False):
        if len(set(column)) > 1:
            break
        shared.append(column[0])
    return "/".join(shared) or "."


def list_names(names: Sequence[str]) -> str:
    """Lists the first few names and the number of others, for a message."""
    listed = ", ".join(name[:_SHOWN_LETTERS] for name in names[:_SHOWN_NAMES])
    return f"{listed} and {len(names) - _SHOWN_NAMES} more" if len(names) > _SHOWN_NAMES else listed


def _problem(name: str, parts: tuple[str, ...]) -> str:
    if not parts:
        return "is empty"
    if any(unicodedata.category(letter) in ("Cc", "Cs") for letter in name):
        return "has control characters or bytes that are not text"
    if "\\" in name:
        return "has a backslash"
    if parts[0].startswith("/") or any(re.match(r"[A-Za-z]:", text) for text in (name, parts[0])):
        return "is absolute"
    if ".." in parts:
        return "leaves its folder by '..'"
    if len(parts) > _MAX_DEPTH:
        return f"is more than {_MAX_DEPTH} folders deep"
    if any(len(part.encode()) > _MAX_NAME_BYTES for part in parts):
        return f"has a part longer than {_MAX_NAME_BYTES} bytes"
    return ""
