"""Resumable files: cut anywhere and resumed, killed anywhere and resumed, the bytes are the same."""

from __future__ import annotations

import hashlib
import random
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Iterable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest

from fastsplat.service.application.uploading.resumable import ResumableUploads
from fastsplat.service.application.uploading.uploads import SPACE_CHECK_BYTES
from fastsplat.service.store.artefact_settings import ArtefactSettings
from fastsplat.service.store.repositories.upload_repository import UploadRecord, UploadRepository
from fastsplat.service.store.store import Store, open_store
from fastsplat_contract.errors import (
    ArtefactError,
    ChecksumMismatchError,
    DatabaseError,
    LimitExceededError,
    NotFoundError,
    OffsetConflictError,
    ResourceError,
    UploadLockedError,
)

_DAY = 24 * 3600.0
_ROOT = Path(__file__).parents[2]


class _CutError(Exception):
    """The sender is gone."""


def _open(tmp_path: Path, data_dir: str, objects: bool) -> Store:
    """Of one database; with objects, bytes are not in the data folder."""
    artefacts = ArtefactSettings(url=f"file://{tmp_path}/bucket") if objects else None
    return open_store(tmp_path / data_dir, f"sqlite:///{tmp_path}/rows.sqlite", artefacts)


@pytest.fixture
def store(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Store]:
    with closing(_open(tmp_path, "data", getattr(request, "param", "folder") == "objects")) as opened:
        yield opened


_anywhere = pytest.mark.parametrize("store", ["folder", "objects"], indirect=True)


@pytest.fixture
def uploads(store: Store) -> ResumableUploads:
    return ResumableUploads(store, 10_000_000, 3600.0)


def _until(data: bytes, cut: int, rng: random.Random) -> Iterator[bytes]:
    """`data` in uneven chunks, breaking off after `cut` bytes."""
    at = 0
    while at < cut:
        step = min(rng.randint(1, 5_000), cut - at)
        yield data[at : at + step]
        at += step
    if cut < len(data):
        raise _CutError


def _append(uploads: ResumableUploads, upload_id: str, at: int, chunks: Iterable[bytes], *sums: Any) -> UploadRecord:
    with closing(uploads.begin_piece("k", upload_id, at, *sums)) as piece:
        for chunk in chunks:
            piece.write(chunk)
        piece.finish()
    return uploads.get("k", upload_id)


def _bytes_of(uploads: ResumableUploads, upload_id: str) -> bytes:
    content = uploads.complete("k", upload_id)[1]
    return content.read_bytes() if isinstance(content, Path) else b"".join(content)


@_anywhere
def test_cut_at_a_hundred_random_offsets_the_bytes_are_the_same(uploads: ResumableUploads) -> None:
    rng = random.Random(7)
    data = rng.randbytes(200_000)
    upload = uploads.create("k", "capture.zip", len(data))
    cuts = sorted(rng.sample(range(len(data)), 100))
    for cut in cuts:
        offset = uploads.get("k", upload.id).offset
        with pytest.raises(_CutError):
            _append(uploads, upload.id, offset, _until(data[offset:], cut - offset, rng))
        assert uploads.get("k", upload.id).offset == cut  # nothing that came is sent twice
    _append(uploads, upload.id, cuts[-1], [data[cuts[-1] :]])
    assert _bytes_of(uploads, upload.id) == data


_APPEND = """
import sys
from pathlib import Path
from fastsplat.service.application.uploading import resumable, upload_piece
from fastsplat.service.store.store import open_store
upload_piece._DURABLE_BYTES = 1 << 16
uploads = resumable.ResumableUploads(open_store(Path(sys.argv[1]), sys.argv[3]), 10**7, 3600.0)
offset = uploads.get("k", sys.argv[2]).offset
piece = uploads.begin_piece("k", sys.argv[2], offset)
while chunk := sys.stdin.buffer.read1(4096):
    piece.write(chunk)
    print(len(chunk), flush=True)
"""


def test_killed_in_mid_piece_and_resumed_the_bytes_are_the_same(uploads: ResumableUploads, tmp_path: Path) -> None:
    rng = random.Random(11)
    data = rng.randbytes(1_000_000)
    upload = uploads.create("k", "capture.zip", len(data))
    for _ in range(2):
        before = uploads.get("k", upload.id).offset
        process = subprocess.Popen(
            [sys.executable, "-c", _APPEND, str(tmp_path / "data"), upload.id, f"sqlite:///{tmp_path}/rows.sqlite"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            cwd=_ROOT,
        )
        assert process.stdin is not None and process.stdout is not None
        process.stdin.write(data[before : before + 150_000])
        process.stdin.flush()
        taken = 0
        while taken < 100_000:
            taken += int(process.stdout.readline())
        with pytest.raises(UploadLockedError):
            _append(uploads, upload.id, before, [b"x"])
        process.send_signal(signal.SIGKILL)
        process.wait()
        process.stdin.close()
        process.stdout.close()
        after = uploads.get("k", upload.id).offset
        assert before < after <= before + 150_000  # something was durable already
    _append(uploads, upload.id, after, [data[after:]])
    assert _bytes_of(uploads, upload.id) == data


@_anywhere
@pytest.mark.parametrize("algorithm", ["sha1", "sha256"])
def test_a_checksum_that_does_not_fit_leaves_nothing_of_its_piece(uploads: ResumableUploads, algorithm: str) -> None:
    upload = uploads.create("k", "a.bin", 20)
    right = hashlib.new(algorithm, b"0123456789").digest()
    _append(uploads, upload.id, 0, [b"01234", b"56789"], (algorithm, right))
    with pytest.raises(ChecksumMismatchError):
        _append(uploads, upload.id, 10, [b"abcdefghiX"], (algorithm, right))
    assert uploads.get("k", upload.id).offset == 10

    def broken() -> Iterator[bytes]:
        yield b"abc"
        raise _CutError

    with pytest.raises(_CutError):  # nobody can tell whether these bytes are right
        _append(uploads, upload.id, 10, broken(), (algorithm, right))
    assert uploads.get("k", upload.id).offset == 10
    _append(uploads, upload.id, 10, [b"0123456789"], (algorithm, right))
    assert _bytes_of(uploads, upload.id) == b"01234567890123456789"


@_anywhere
def test_only_the_next_byte_may_follow(uploads: ResumableUploads) -> None:
    upload = uploads.create("k", "a.bin", 10)
    _append(uploads, upload.id, 0, [b"01234"])
    for offset in (0, 4, 6, 10):
        with pytest.raises(OffsetConflictError):
            _append(uploads, upload.id, offset, [b"x"])
    with pytest.raises(OffsetConflictError):
        uploads.complete("k", upload.id)
    with pytest.raises(LimitExceededError):
        _append(uploads, upload.id, 5, [b"56", b"789x"])
    assert uploads.get("k", upload.id).offset == 7
    _append(uploads, upload.id, 7, [b"789"])
    assert _append(uploads, upload.id, 10, []).offset == 10
    assert _bytes_of(uploads, upload.id) == b"0123456789"


def test_two_senders_at_once_never_mix(uploads: ResumableUploads) -> None:
    upload = uploads.create("k", "a.bin", 4)
    inside, go_on = threading.Event(), threading.Event()

    def slow() -> Iterator[bytes]:
        yield b"ab"
        inside.set()
        assert go_on.wait(30)
        yield b"cd"

    first = threading.Thread(target=lambda: _append(uploads, upload.id, 0, slow()))
    first.start()
    assert inside.wait(30)
    with pytest.raises(UploadLockedError):
        _append(uploads, upload.id, 0, [b"WXYZ"])
    with pytest.raises(UploadLockedError):
        uploads.delete("k", upload.id)
    go_on.set()
    first.join()
    assert _bytes_of(uploads, upload.id) == b"abcd"


def test_of_two_servers_that_share_a_store_the_faster_one_goes_on(tmp_path: Path) -> None:
    with closing(_open(tmp_path, "here", True)) as here, closing(_open(tmp_path, "there", True)) as there:
        first, second = (ResumableUploads(store, 100, 3600.0) for store in (here, there))
        upload = first.create("k", "a.bin", 6)
        with closing(first.begin_piece("k", upload.id, 0)) as slow:
            slow.write(b"XYZ")
            assert _append(second, upload.id, 0, [b"ab"]).offset == 2
            with pytest.raises(OffsetConflictError):
                slow.finish()
        assert first.get("k", upload.id).offset == 2
        _append(first, upload.id, 2, [b"cd"])
        _append(second, upload.id, 4, [b"ef"])
        assert _bytes_of(first, upload.id) == _bytes_of(second, upload.id) == b"abcdef"
        assert here.blobs.ids("uploads") == there.blobs.ids("uploads") == (upload.id,)
        assert here.jobs.unneeded_uploads([upload.id], 0.0) == (frozenset(), frozenset())
        second.delete("k", upload.id)
        for uploads in (first, second):
            with pytest.raises(NotFoundError):
                uploads.get("k", upload.id)
        assert here.blobs.ids("uploads") == there.blobs.ids("uploads") == ()


def test_bytes_that_a_failing_database_did_not_count_are_counted_once_it_answers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with closing(_open(tmp_path, "data", True)) as store:
        uploads = ResumableUploads(store, 100, 3600.0)
        upload = uploads.create("k", "a.bin", 3)
        with closing(uploads.begin_piece("k", upload.id, 0)) as piece, monkeypatch.context() as patch:
            piece.write(b"abc")
            patch.setattr(UploadRepository, "advance", Mock(side_effect=DatabaseError("away")))
            with pytest.raises(DatabaseError):
                piece.finish()
            patch.undo()
        assert _bytes_of(uploads, upload.id) == b"abc"
        (path,) = (tmp_path / "bucket" / "uploads" / upload.id).rglob("*-*")
        path.write_bytes(b"abd")
        with pytest.raises(ArtefactError):
            _bytes_of(uploads, upload.id)


def test_an_upload_expires_and_each_piece_gives_it_more_time(store: Store) -> None:
    now = [1.8e9]
    uploads = ResumableUploads(store, 100, 50.0, wall=lambda: now[0])
    upload = uploads.create("k", "a.bin", 4)
    now[0] += 30.0
    assert _append(uploads, upload.id, 0, [b"x"]).expires_at == pytest.approx(upload.expires_at + 30.0)
    now[0] += 40.0
    assert uploads.get("k", upload.id).offset == 1
    now[0] += 11.0
    with pytest.raises(NotFoundError):
        uploads.get("k", upload.id)


def test_a_full_disk_is_told_and_what_came_stays(uploads: ResumableUploads, monkeypatch: pytest.MonkeyPatch) -> None:
    upload = uploads.create("k", "a.bin", 10)
    with closing(uploads.begin_piece("k", upload.id, 0)) as piece:
        piece.write(b"01234")
        with monkeypatch.context() as patch:
            patch.setattr(piece, "_data", Mock(write=Mock(side_effect=OSError(28, "No space left on device"))))
            with pytest.raises(ResourceError, match="full"):
                piece.write(b"56789")
    assert uploads.get("k", upload.id).offset == 5


def test_a_piece_ends_when_the_disk_becomes_almost_full_meanwhile(
    store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    uploads = ResumableUploads(store, 1 << 30, 3600.0, min_free_bytes=1 << 30)
    upload = uploads.create("k", "a.zip", 2 * SPACE_CHECK_BYTES)
    free = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: free._replace(free=free.total // 1000))
    with pytest.raises(ResourceError) as caught:
        _append(uploads, upload.id, 0, [bytes(SPACE_CHECK_BYTES)])
    assert "MIN_FREE_BYTES" in caught.value.limit
    monkeypatch.undo()
    assert _append(uploads, upload.id, 0, [bytes(2 * SPACE_CHECK_BYTES)]).offset == 2 * SPACE_CHECK_BYTES
