"""Names of files that strangers chose."""

from __future__ import annotations

import re
import unicodedata
from pathlib import PurePosixPath

from fastsplat_contract.errors import UnsafeArchiveError

_MAX_DEPTH = 16
_MAX_NAME_BYTES = 255
_LITTER = frozenset({"__MACOSX", "Thumbs.db", "desktop.ini"})


def safe_parts(name: str, *, archive: str) -> tuple[str, ...]:
    """The parts of an archive entry's name, if it can be written below a folder; "./" in front is dropped.

    Raises:
        UnsafeArchiveError: absolute, empty, too long or too deep, or with "..", a drive letter, control characters
            or bytes that are no text.
    """
    parts = tuple(part for part in PurePosixPath(name.replace("\\", "/")).parts if part != ".")
    shown = name[:80].encode("ascii", "backslashreplace").decode()
    problem = ""
    if not parts:
        problem = "has no name"
    elif parts[0].startswith("/") or re.match(r"[A-Za-z]:", parts[0]):
        problem = "has an absolute path"
    elif ".." in parts:
        problem = "leaves its folder by '..'"
    elif len(parts) > _MAX_DEPTH:
        problem = f"lies more than {_MAX_DEPTH} folders deep"
    elif any(unicodedata.category(letter) in ("Cc", "Cs") for letter in name):
        problem = "has control characters or bytes that are no text in its name"
    elif any(len(part.encode()) > _MAX_NAME_BYTES for part in parts):
        problem = f"has a name longer than {_MAX_NAME_BYTES} bytes"
    if problem:
        raise UnsafeArchiveError(
            f"{archive}: the entry {shown!r} {problem}",
            field=shown,
            hint="Pack the folder again with relative names below it.",
        )
    return parts


def is_litter(parts: tuple[str, ...]) -> bool:
    """Whether a file is an operating system's leftover, or hidden, and none of the user's content."""
    return any(part in _LITTER or part.startswith(".") for part in parts)
