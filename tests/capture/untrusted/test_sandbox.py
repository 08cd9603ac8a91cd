"""The sandbox: the same errors as in process, its environment and its limits; what kills it ends one request."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest

from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.untrusted import sandbox
from fastsplat.service.capture.untrusted.sandbox import validate_in_sandbox
from fastsplat.service.capture.uploads.upload_validation import validate_upload
from fastsplat.service.common.cancellation import Cancellation, cancellable
from fastsplat.service.scene.formats.zips import zipped
from fastsplat_contract.errors import CancelledError, FastSplatError, InvalidInputError, ResourceError
from tests.capture.upload_files import photo_file, video_file

_PHOTOS = {f"{number} ü.jpg": photo_file(number) for number in range(3)}
_UPLOADS = {
    "photos": _PHOTOS,
    "archive": {"capture.zip": zipped({f"images/{number}.jpg": photo_file(number) for number in range(2)})},
    "damaged": _PHOTOS | {"2 ü.jpg": photo_file(2)[:800]},
    "climbing": {"capture.zip": zipped({"../../out.jpg": photo_file(1)})},
    "empty": {"notes.txt": b"nothing"},
    "unreadable poses": _PHOTOS | {"transforms.json": b'{"frames": [' * 5_000},
    "video": {},
}


def _write(folder: Path, files: Mapping[str, bytes] = _PHOTOS) -> None:
    for name, content in files.items():
        (folder / name).write_bytes(content)


def _outcome(validate: Callable[[Path, CaptureSettings], object], folder: Path, sent: str) -> str:
    folder.mkdir()
    _write(folder, _UPLOADS[sent])
    if sent == "video":
        frames = np.random.default_rng(0).integers(0, 255, (8, 48, 64, 3), dtype=np.uint8)
        video_file(folder / "walk.mp4", frames, "mp4v")
    try:
        outcome = vars(validate(folder, CaptureSettings()))
    except FastSplatError as error:
        outcome = {"error": type(error).__name__, "message": error.message, **error.details()}
    return json.dumps(outcome, default=str).replace(str(folder), "HERE")


@pytest.mark.parametrize("sent", _UPLOADS)
def test_the_child_says_what_the_process_itself_would_say(tmp_path: Path, sent: str) -> None:
    alone = _outcome(validate_upload, tmp_path / "alone", sent)
    assert _outcome(validate_in_sandbox, tmp_path / "isolated", sent) == alone


def test_an_upload_that_takes_too_much_memory_is_refused(tmp_path: Path) -> None:
    for number in range(2):
        (tmp_path / f"{number}.jpg").write_bytes(photo_file(number, (3_000, 3_000)))
    with pytest.raises(ResourceError) as caught:
        validate_in_sandbox(tmp_path, CaptureSettings(validation_memory_bytes=300 * 2**20))
    assert caught.value.limit == f"{300 * 2**20} bytes" and "upload" in caught.value.message
    assert validate_in_sandbox(tmp_path, CaptureSettings()).images == 2


def test_an_upload_that_takes_too_long_is_refused(tmp_path: Path) -> None:
    _write(tmp_path)
    with pytest.raises(ResourceError) as caught:
        validate_in_sandbox(tmp_path, CaptureSettings(validation_seconds=0))
    assert caught.value.limit == "0 s"


def test_validation_stops_when_the_caller_is_cancelled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _write(tmp_path)
    monkeypatch.setattr(sandbox, "_HEARTBEAT_S", 0.01)
    cancellation = Cancellation()
    cancellation.cancel()
    with cancellable(cancellation), pytest.raises(CancelledError):
        validate_in_sandbox(tmp_path, CaptureSettings())


def test_the_child_runs_in_the_environment_of_the_sandbox(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "upload").mkdir()
    (tmp_path / "task").mkdir()
    _write(tmp_path / "upload")
    monkeypatch.setattr(sandbox, "_HEARTBEAT_S", 0.01)
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "7")
    monkeypatch.setenv("FASTSPLAT_DATABASE_URL", "postgresql://user:secret@host/name")
    monkeypatch.setenv("A_SECRET", "of another program")
    environments: list[list[bytes]] = []

    def listen(fraction: float, message: str) -> None:
        children = Path(f"/proc/self/task/{threading.get_native_id()}/children").read_text().split()
        environments.extend(Path(f"/proc/{child}/environ").read_bytes().split(b"\0") for child in children)

    settings = CaptureSettings()
    request = {"upload": str(tmp_path / "upload"), "settings": settings.model_dump(mode="json")}
    sandbox.run_sandboxed("validate", request, tmp_path / "task", settings, listen)
    assert environments
    last = environments[-1]  # the first may be that of a child before its exec
    for entry in (b"OPENBLAS_NUM_THREADS=1", b"OMP_WAIT_POLICY=passive"):
        assert entry in last
    assert any(entry.startswith(b"OPENCV_FFMPEG_CAPTURE_OPTIONS=protocol_whitelist;file|") for entry in last)
    known = {*sandbox._ENVIRONMENT, *sandbox._PASSED_ON, "HOME", "TMPDIR", ""}
    assert {entry.partition(b"=")[0].decode() for entry in last} <= known


def _probe(video: Path, work: Path, settings: CaptureSettings) -> dict[str, int]:
    work.mkdir()
    request = {"video": str(video), "name": video.name, **settings.model_dump()}
    return sandbox.run_sandboxed("probe", request, work, settings, lambda fraction, message: None)


def test_a_playlist_called_video_gets_nothing_of_the_video_that_it_names(tmp_path: Path) -> None:
    clip, playlist = tmp_path / "clip.avi", tmp_path / "playlist.avi"
    video_file(clip, [np.full((48, 64, 3), 60 * number, np.uint8) for number in range(4)])
    playlist.write_text("ffconcat version 1.0\nfile clip.avi\n")
    assert _probe(clip, tmp_path / "one", CaptureSettings()) == {"width": 64, "height": 48}
    with pytest.raises(InvalidInputError):
        _probe(playlist, tmp_path / "other", CaptureSettings())


def test_a_full_disk_is_a_typed_error(tmp_path: Path) -> None:
    """A bound on the size of a file stands for the disk's end: the same code meets EFBIG and ENOSPC."""
    upload, work = tmp_path / "upload", tmp_path / "work"
    upload.mkdir()
    work.mkdir()
    _write(upload, {"capture.zip": zipped({"a.jpg": photo_file(1, (640, 480)), "b.jpg": photo_file(2)})})
    request = {"upload": str(upload), "settings": CaptureSettings().model_dump(mode="json")}
    small = CaptureSettings(max_unpacked_bytes=20_000)
    with pytest.raises(ResourceError) as caught:
        sandbox.run_sandboxed("validate", request, work, small, lambda fraction, message: None)
    assert "disk" in caught.value.message and caught.value.hint
    assert [path.name for path in upload.iterdir()] == ["capture.zip"]


def test_a_child_whose_parent_died_before_it_looked_does_nothing(tmp_path: Path) -> None:
    over = subprocess.Popen([sys.executable, "-c", ""])
    over.wait()
    bounds = {"memory_bytes": 6 << 30, "cpu_seconds": 600, "file_bytes": 1 << 30}
    limits = {"limits": bounds, "memory_limit": "", "description": ""}
    upload = tmp_path / "upload"
    upload.mkdir()
    _write(upload)
    settings = CaptureSettings().model_dump(mode="json")
    (tmp_path / "request.json").write_text(json.dumps({"upload": str(upload), "settings": settings, **limits}))
    command = [sys.executable, "-m", "fastsplat.service.capture.untrusted.sandbox_worker", "validate", str(tmp_path)]
    assert subprocess.run([*command, str(over.pid)], check=False).returncode == 1
    assert not (tmp_path / "result.json").exists()
    assert subprocess.run([*command, str(os.getpid())], check=False).returncode == 0
    assert (tmp_path / "result.json").exists()
