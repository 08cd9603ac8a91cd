"""Digests of a published folder's files, in its file `files.sha256` (format of sha256sum(1)).

Disks flip bits, so files are checked before they are served. A result is kept while the file looks unchanged, but not
forever, as a disk changes bytes without changing a file's time.
"""

from __future__ import annotations

import re
import threading
import time
from collections import OrderedDict
from collections.abc import Iterator
from pathlib import Path

from fastsplat.service.common.files import file_sha256
from fastsplat_contract.errors import SceneFileError

DIGESTS = "files.sha256"
_LINE = re.compile(r"([0-9a-f]{64})  (.+)")
_HINT = "Restore the scene's folder from a backup, undo to an earlier version, or train it again."
_TRUSTED_S = 3600.0
_REMEMBERED = 10_000


def write_digests(folder: Path) -> None:
    """Writes the digests of all files of a folder before it is published."""
    target = folder / DIGESTS
    names = sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())
    lines = [f"{file_sha256(folder / name)}  {name}\n" for name in names if name != DIGESTS]
    target.write_text("".join(lines), encoding="utf-8")


def check_files(folder: Path, *names: str) -> None:
    """Checks files of a published folder, by default all; raises the first of `damaged_files`."""
    for error in damaged_files(folder, *names):
        raise error


def damaged_files(folder: Path, *names: str) -> Iterator[SceneFileError]:
    """Yields an error per damaged or missing file; none for folders without digests."""
    try:
        digests = _read(folder) or {}
    except SceneFileError as error:
        yield error
        return
    for name in names or digests if digests else ():
        if name not in digests:
            yield SceneFileError(f"{DIGESTS} has no digest of {name}", field=DIGESTS, hint=_HINT)
        elif not _CHECKED.holds(folder / name, digests[name]):
            message = f"{name} is damaged: it does not match its digest in {DIGESTS}"
            yield SceneFileError(message, field=name, hint=_HINT)


def _read(folder: Path) -> dict[str, str] | None:
    try:
        lines = (folder / DIGESTS).read_text(encoding="utf-8").splitlines()
    except FileNotFoundError:
        return None
    except ValueError as error:
        raise SceneFileError(f"{DIGESTS} is damaged", field=DIGESTS, hint=_HINT) from error
    matches = [_LINE.fullmatch(line) for line in lines]
    if None in matches or not lines:
        raise SceneFileError(f"{DIGESTS} is damaged", field=DIGESTS, hint=_HINT)
    return {match[2]: match[1] for match in matches if match}


class _Checked:
    """Recently verified files that look unchanged; safe from any thread."""

    def __init__(self) -> None:
        self._seen: OrderedDict[tuple[int, ...], tuple[str, float]] = OrderedDict()
        self._lock = threading.Lock()

    def holds(self, path: Path, digest: str) -> bool:
        """True if the file exists and has that digest."""
        try:
            status = path.stat()
            key = (status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns)
            with self._lock:
                known = self._seen.get(key)
            if known is not None and known[0] == digest and time.monotonic() < known[1]:
                return True
            if file_sha256(path) != digest:
                return False
        except FileNotFoundError:
            return False
        with self._lock:
            self._seen[key] = (digest, time.monotonic() + _TRUSTED_S)
            while len(self._seen) > _REMEMBERED:
                self._seen.popitem(last=False)
        return True


_CHECKED = _Checked()
