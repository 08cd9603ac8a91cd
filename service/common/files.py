"""Digests of files; atomic writes: hidden name beside the target, fsync, rename."""

from __future__ import annotations

import errno
import hashlib
import os
import shutil
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def atomic_file(target: Path, *, replace: bool = True) -> Iterator[Path]:
    """Yields a temporary path beside `target` that becomes it if the block succeeds.

    Raises:
        FileExistsError: `target` exists and `replace` is false.
        OSError: the disk is full or not writable.
    """
    partial = _beside(target)
    try:
        yield partial
        _sync(partial)
        if replace:
            partial.replace(target)
        else:
            os.link(partial, target)  # fails where a rename would replace
    finally:
        partial.unlink(missing_ok=True)
    sync_directory(target.parent)


@contextmanager
def atomic_directory(target: Path, *, replace: bool = True) -> Iterator[Path]:
    """Yields a temporary directory beside `target` that becomes it if the block succeeds.

    A reader sees the old directory, for an instant none, or the complete new one. Missing parents are created.

    Raises:
        FileExistsError: `target` exists, is not empty, and `replace` is false.
        OSError: the disk is full or not writable.
    """
    partial = _beside(target)
    partial.mkdir(parents=True)
    try:
        yield partial
        publish_directory(partial, target, replace=replace)
    except BaseException:
        shutil.rmtree(partial, ignore_errors=True)
        raise


def publish_directory(source: Path, target: Path, *, replace: bool = False) -> None:
    """Flushes a finished directory and renames it to `target`, on the same file system.

    Raises:
        FileExistsError: `target` exists, is not empty, and `replace` is false; both stay unchanged.
        OSError: the disk is full or not writable.
    """
    sync_tree(source)
    try:
        source.rename(target)  # replaces an empty directory, see rename(2)
    except OSError as error:
        if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
            raise
        if not replace:
            raise FileExistsError(error.errno, "the directory is there already", str(target)) from error
        _swap(source, target)
    sync_directory(target.parent)


def sync_tree(directory: Path) -> None:
    """Flushes a directory, and everything below it, to the disk (fsync)."""
    for current, _, files in os.walk(directory):
        for name in files:
            _sync(Path(current) / name)
        sync_directory(Path(current))


def sync_directory(directory: Path) -> None:
    _sync(directory)


def link_or_copy(source: str | Path, target: str | Path) -> None:
    """Hard-links `source` to the new path `target`; copies across file systems."""
    try:
        os.link(source, target)
    except OSError:  # another disk, or a file system without hard links
        shutil.copyfile(source, target)


def _swap(source: Path, target: Path) -> None:
    old = _beside(target)
    target.rename(old)
    try:
        source.rename(target)
    except BaseException:
        old.rename(target)
        raise
    shutil.rmtree(old, ignore_errors=True)


def _beside(target: Path) -> Path:
    # Readers skip names with a leading dot, so leftovers of a crash are never read.
    return target.with_name(f".{target.name.lstrip('.')}.{uuid.uuid4().hex}")


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def file_sha256(path: Path) -> str:
    """Hex SHA-256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
