"""Atomic writes of files and directories: written under a hidden name beside their place, flushed to the disk, then
renamed; what a crash leaves behind begins with a dot and is never read."""

from __future__ import annotations

import errno
import os
import shutil
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def atomic_file(target: Path, *, replace: bool = True) -> Iterator[Path]:
    """A path beside `target` to write a file to; it becomes `target` if the block ends well, and vanishes if not.

    Args:
        target: its directory exists.
        replace: whether a file that is there already is replaced.

    Raises:
        FileExistsError: `target` is there and `replace` is false; it stays as it was.
        OSError: the disk is full or cannot be written.
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
    """A new directory beside `target`; it becomes `target` if the block ends well, and vanishes if not.

    A reader sees the old directory, for an instant none, or the whole new one.

    Args:
        target: parents that are missing are made.
        replace: whether a directory that is there already is replaced.

    Raises:
        FileExistsError: `target` is there, is not empty, and `replace` is false; it stays as it was.
        OSError: the disk is full or cannot be written.
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
    """Flush a finished directory to the disk and rename it to `target`, on the same file system.

    Raises:
        FileExistsError: `target` is there, is not empty, and `replace` is false; both stay as they were.
        OSError: the disk is full or cannot be written.
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
    """Flush every file and directory below `directory`, and itself, to the disk (fsync)."""
    for current, _, files in os.walk(directory):
        for name in files:
            _sync(Path(current) / name)
        sync_directory(Path(current))


def sync_directory(directory: Path) -> None:
    """Flush a directory's entries to the disk: what was created in, renamed into or removed from it (fsync)."""
    _sync(directory)


def link_or_copy(source: str | Path, target: str | Path) -> None:
    """Make a file one of another place, too, which is on the same disk a link, else a copy; `target` is not there."""
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
    return target.with_name(f".{target.name.lstrip('.')}.{uuid.uuid4().hex}")


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
