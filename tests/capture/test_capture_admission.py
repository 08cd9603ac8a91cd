"""Admission in a child process: the same words as in process, and what kills the child kills one request."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fastsplat.service.capture import admit_upload, isolation
from fastsplat.service.capture.admission import admit_isolated
from fastsplat.service.capture.settings import CaptureSettings
from fastsplat.service.common.cancellation import Cancellation, cancellable
from fastsplat_contract.errors import CancelledError, FastSplatError, ResourceError


def _photo(seed: int, size: tuple[int, int] = (64, 48)) -> bytes:
    pixels = np.random.default_rng(seed).integers(0, 255, (size[1], size[0], 3), dtype=np.uint8)
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "JPEG")
    return buffer.getvalue()


def _photos(folder: Path) -> None:
    for number in range(3):
        (folder / f"{number} ü.jpg").write_bytes(_photo(number))


def _archive(folder: Path) -> None:
    with zipfile.ZipFile(folder / "capture.zip", "w") as archive:
        for number in range(2):
            archive.writestr(f"images/{number}.jpg", _photo(number))


def _damaged(folder: Path) -> None:
    _photos(folder)
    (folder / "2 ü.jpg").write_bytes(_photo(2)[:800])


def _climbing(folder: Path) -> None:
    with zipfile.ZipFile(folder / "capture.zip", "w") as archive:
        archive.writestr("../../out.jpg", _photo(1))


def _empty(folder: Path) -> None:
    (folder / "notes.txt").write_text("nothing")


def _unreadable_poses(folder: Path) -> None:
    _photos(folder)
    (folder / "transforms.json").write_text('{"frames": [' * 5_000)


_UPLOADS = (_photos, _archive, _damaged, _climbing, _empty, _unreadable_poses)


def _outcome(admit: Callable[[Path, CaptureSettings], object], folder: Path, fill: Callable[[Path], None]) -> str:
    folder.mkdir()
    fill(folder)
    try:
        found = vars(admit(folder, CaptureSettings()))
    except FastSplatError as error:
        found = {"error": type(error).__name__, "message": error.message, **error.details()}
    return json.dumps(found, default=str).replace(str(folder), "HERE")


@pytest.mark.parametrize("fill", _UPLOADS)
def test_the_child_says_what_the_process_itself_would_say(tmp_path: Path, fill: Callable[[Path], None]) -> None:
    alone = _outcome(admit_upload, tmp_path / "alone", fill)
    assert _outcome(admit_isolated, tmp_path / "isolated", fill) == alone


def test_an_upload_that_takes_too_much_memory_is_refused(tmp_path: Path) -> None:
    for number in range(2):
        (tmp_path / f"{number}.jpg").write_bytes(_photo(number, (3_000, 3_000)))
    with pytest.raises(ResourceError) as caught:
        admit_isolated(tmp_path, CaptureSettings(admit_memory_bytes=300 * 2**20))
    assert "FASTSPLAT_CAPTURE__ADMIT_MEMORY_BYTES" in caught.value.limit and "upload" in caught.value.message
    assert admit_isolated(tmp_path, CaptureSettings()).images == 2


def test_an_upload_that_takes_too_long_is_refused(tmp_path: Path) -> None:
    _photos(tmp_path)
    with pytest.raises(ResourceError) as caught:
        admit_isolated(tmp_path, CaptureSettings(admit_seconds=0))
    assert "FASTSPLAT_CAPTURE__ADMIT_SECONDS" in caught.value.limit


def test_nobody_looks_on_when_the_sender_has_gone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _photos(tmp_path)
    monkeypatch.setattr(isolation, "_HEARTBEAT_S", 0.01)
    gone = Cancellation()
    gone.cancel()
    with cancellable(gone), pytest.raises(CancelledError):
        admit_isolated(tmp_path, CaptureSettings())
