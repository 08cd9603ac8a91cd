"""Finds files of an upload by the names in documents of other programs."""

from __future__ import annotations

import os
import posixpath
from collections.abc import Iterable, Sequence
from functools import cached_property
from itertools import islice
from pathlib import Path
from unicodedata import normalize

from fastsplat_contract.errors import InvalidInputError

FOLDERS_WITHOUT_PHOTOS = frozenset({"labels", "masks", "mask", "depth", "depths", "confidence"})


class NamedFiles:
    """Files of an upload by the names in a `document`; differences are kept for `warnings`."""

    def __init__(self, root: Path, document: str) -> None:
        self._root, self._document = root, document
        self._differing: dict[str, dict[str, str]] = {}
        self._exact = set[str | None]()

    def expect(self, folder: str, names: Iterable[str]) -> None:
        """Reserves the files that these names mean exactly, so that no other name matches them."""
        self._exact.update(self._inside(folder, name) for name in names)

    def path(self, folder: str, name: str, field: str, *, photo: bool = False, suffixes: Sequence[str] = ()) -> str:
        """Finds the file meant by a name in `folder`; returns its path in the upload.

        Tried in order: exactly, in another Unicode form or with slashes for backslashes, in another letter case, and by
        the most last parts shared with a unique file. Without a match, returns the path that the name spells.

        Args:
            photo: folders of masks and the like are searched only if the name has them.
            suffixes: that the name may omit.

        Raises:
            InvalidInputError: the name leads out of the upload and matches no file in it.
        """
        names = [*(name + suffix for suffix in suffixes), name]
        for inside in (self._inside(folder, candidate) for candidate in names):
            if inside is not None and self.has(inside):
                return inside
        for candidate in names:
            if (alike := self._alike(folder, candidate, photo)) is not None:
                return alike
        if (path := self._inside(folder, name)) is None:
            raise _not_in_upload(name, field)
        return path

    def file(self, folder: str, name: str, field: str, *, photo: bool = False) -> str:
        """Finds an existing file as `path` does; raises `InvalidInputError` without one."""
        path = self.path(folder, name, field, photo=photo)
        if not self.has(path):
            raise _not_in_upload(name, field)
        return path

    def has(self, path: str) -> bool:
        """Checks for a file; unlike `Path.is_file`, accepts names that are too long."""
        return os.path.isfile(self._root / path)

    def warnings(self) -> tuple[str, ...]:
        """Makes one sentence for people per kind of difference between names and files."""
        return tuple(
            f"{len(found)} names in {self._document} differ from the files that they mean by {how}, e.g. "
            f"{name[:200].encode(errors='replace').decode()} means {found[name][:200]}."  # a document may have any text
            for how, found in self._differing.items()
            for name in islice(found, 1)
        )

    def _inside(self, folder: str, name: str) -> str | None:
        """Resolves a path relative to the root, following links; None outside of it."""
        if "\0" in name:
            return None
        root, resolved = self._root.resolve(), (self._root / folder / name).resolve()
        return resolved.relative_to(root).as_posix() if resolved.is_relative_to(root) else None

    @cached_property
    def _by_last_part(self) -> dict[str, list[str]]:
        paths: dict[str, list[str]] = {}
        for path in sorted(self._root.rglob("*")):
            if path.is_file():
                paths.setdefault(_folded(path.name), []).append(path.relative_to(self._root).as_posix())
        return paths

    def _alike(self, folder: str, name: str, photo: bool) -> str | None:
        slashed = normalize("NFC", name.replace("\\", "/"))
        whole = posixpath.normpath(posixpath.join(normalize("NFC", folder), slashed))
        candidates = self._by_last_part.get(_folded(posixpath.basename(whole)), [])
        candidates = [path for path in candidates if path not in self._exact]
        parts = [part for part in _folded(slashed).split("/") if part not in ("", ".", "..")]
        spelled = [path for path in candidates if normalize("NFC", path) == whole]
        folded = [path for path in candidates if _folded(path) == _folded(whole)]
        if photo and not FOLDERS_WITHOUT_PHOTOS.intersection(parts):
            candidates = [path for path in candidates if not FOLDERS_WITHOUT_PHOTOS.intersection(path.split("/"))]
        ends = [(begin, path) for path in candidates if (begin := _shared(path, parts))]
        longest = [path for shared, path in ends if shared == max(ends)[0]]
        form = "backslashes" if "\\" in name else "the Unicode form of letters"
        for how, found in ((form, spelled), ("letter case", folded), ("folders", longest)):
            if found:
                if len(found) == 1:
                    self._differing.setdefault(how, {})[name] = found[0]
                return found[0] if len(found) == 1 else None
        return None


def _shared(path: str, parts: Sequence[str]) -> int:
    """Counts the last parts shared by a path and a name."""
    return len(posixpath.commonprefix([_folded(path).split("/")[::-1], list(parts[::-1])]))


def _folded(name: str) -> str:
    return normalize("NFC", name).casefold()


def _not_in_upload(name: str, field: str) -> InvalidInputError:
    return InvalidInputError.of(
        field,
        f"names the file {name[:200]!r}, which is not in the upload",
        "Send every image that has a pose, under the name that the poses use.",
    )
