"""Atomic files and directories: the old, or the whole new, on the disk before it is in sight, or an OSError."""

from __future__ import annotations

import errno
import os
import resource
import signal
import subprocess
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

import numpy as np
import pytest

from fastsplat.service.common.array_files import write_arrays
from fastsplat.service.common.files import atomic_directory, atomic_file, publish_directory

Atomic = Callable[..., AbstractContextManager[Path]]


def _write(path: Path, text: str, atomic: Atomic) -> None:
    """`text` into the file itself, or into a file two levels down in the directory."""
    if atomic is atomic_file:
        path.write_text(text)
    else:
        (path / "deep").mkdir(exist_ok=True)
        (path / "deep" / "file").write_text(text)


def _read(path: Path) -> str:
    return (path / "deep" / "file" if path.is_dir() else path).read_text()


def _fail_halfway(target: Path, atomic: Atomic, error: BaseException) -> None:
    with atomic(target) as partial:
        _write(partial, "half", atomic)
        raise error


both = pytest.mark.parametrize("atomic", [atomic_file, atomic_directory])


@both
def test_it_appears_whole_and_replaces_the_old(atomic: Atomic, tmp_path: Path) -> None:
    target = tmp_path / "it"
    for text in ("first", "second"):
        before = _read(target) if target.exists() else None
        with atomic(target) as partial:
            _write(partial, text, atomic)
            assert (_read(target) if target.exists() else None) == before
        assert _read(target) == text
        assert list(tmp_path.iterdir()) == [target]


@both
def test_an_error_leaves_the_old(atomic: Atomic, tmp_path: Path) -> None:
    target = tmp_path / "it"
    with pytest.raises(KeyboardInterrupt):
        _fail_halfway(target, atomic, KeyboardInterrupt())
    assert list(tmp_path.iterdir()) == []
    with atomic(target) as partial:
        _write(partial, "old", atomic)
    with pytest.raises(ValueError, match="stop"):
        _fail_halfway(target, atomic, ValueError("stop"))
    assert _read(target) == "old" and list(tmp_path.iterdir()) == [target]


@both
def test_without_replace_the_first_one_stays(atomic: Atomic, tmp_path: Path) -> None:
    target = tmp_path / "it"
    with atomic(target, replace=False) as partial:
        _write(partial, "first", atomic)
    with pytest.raises(FileExistsError), atomic(target, replace=False) as partial:
        _write(partial, "second", atomic)
    assert _read(target) == "first" and list(tmp_path.iterdir()) == [target]


def test_a_directory_is_published_once(tmp_path: Path) -> None:
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "file").write_text(name)
    publish_directory(tmp_path / "one", tmp_path / "it")
    with pytest.raises(FileExistsError):
        publish_directory(tmp_path / "two", tmp_path / "it")
    assert (tmp_path / "it" / "file").read_text() == "one" and (tmp_path / "two" / "file").read_text() == "two"
    publish_directory(tmp_path / "two", tmp_path / "it", replace=True)
    assert (tmp_path / "it" / "file").read_text() == "two" and list(tmp_path.iterdir()) == [tmp_path / "it"]


@both
def test_every_byte_is_on_the_disk_before_the_name_is(
    atomic: Atomic, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Files are flushed under their hidden name, the directory around them once the name is theirs."""
    synced: list[tuple[str, bool]] = []
    target, flush = tmp_path / "it", os.fsync

    def fsync(handle: int) -> None:
        flush(handle)
        path = Path(os.readlink(f"/proc/self/fd/{handle}"))
        synced.append((path.relative_to(tmp_path).as_posix(), target.exists()))

    monkeypatch.setattr(os, "fsync", fsync)
    with atomic(target) as partial:
        _write(partial, "text", atomic)
        name = partial.name
    content = [f"{name}/deep/file", f"{name}/deep", name] if atomic is atomic_directory else [name]
    assert sorted(synced[:-1]) == sorted((path, False) for path in content)
    assert synced[-1] == (".", True)


@both
def test_a_process_that_dies_in_between_leaves_the_old(atomic: Atomic, tmp_path: Path) -> None:
    target = tmp_path / "it"
    with atomic(target) as partial:
        _write(partial, "old", atomic)
    program = f"""
import os, signal
from pathlib import Path
from fastsplat.service.common.files import {atomic.__name__} as atomic
with atomic(Path({str(target)!r})) as partial:
    (partial if {atomic is atomic_file} else partial / "deep").write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)
"""
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == -signal.SIGKILL
    assert _read(target) == "old"
    assert all(path == target or path.name.startswith(".it.") for path in tmp_path.iterdir())


def test_an_end_of_the_disk_is_the_systems_own_error(tmp_path: Path) -> None:
    """A bound on the size of a file stands for the disk's end."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, before[1]))
    try:
        with pytest.raises(OSError, match="large") as caught:
            write_arrays({"a": np.zeros(10_000, np.float32)}, tmp_path / "a.safetensors")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert caught.value.errno == errno.EFBIG and signal.getsignal(signal.SIGXFSZ) == signal.SIG_IGN
