"""The clock for ages: it goes with the wall clock, and no jump of that makes anything old."""

from __future__ import annotations

import os
import time
from contextlib import closing
from pathlib import Path

import pytest

from fastsplat.service.application.uploading.uploads import UploadSession
from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.store.blobs.activity_clock import ActivityClock
from fastsplat.service.store.blobs.blobs import Blobs
from fastsplat.service.store.repositories.upload_repository import UploadRecord
from fastsplat.service.store.store import open_store

_DAY = 86_400.0
_UNWRITTEN_S = 31.0  # it writes down how far it is about twice a minute


class _Wall:
    """A wall clock that somebody sets."""

    def __init__(self, at: float = 1.8e9) -> None:
        self.at = at

    def __call__(self) -> float:
        return self.at


def test_it_goes_with_the_wall_clock_over_restarts(tmp_path: Path) -> None:
    wall = _Wall()
    assert ActivityClock(tmp_path, wall).now() == wall.at
    for _ in range(100):
        wall.at += 61.0
        assert ActivityClock(tmp_path, wall).now() == pytest.approx(wall.at, abs=0.01)


@pytest.mark.parametrize("jump", [_DAY, -_DAY, 50 * 365 * _DAY, -50 * 365 * _DAY])
def test_a_jump_adds_at_most_an_hour_and_takes_nothing_back(tmp_path: Path, jump: float) -> None:
    wall = _Wall()
    clock = ActivityClock(tmp_path, wall)
    before = clock.now()
    for step in (jump, 10.0, -jump, 10.0, jump):
        wall.at += step
        now = clock.now()
        assert before - _UNWRITTEN_S <= now <= before + 3_600.0 + _UNWRITTEN_S
        before = now
    for _ in range(60):
        wall.at += 60.0
        clock.now()
    assert clock.now() == pytest.approx(before + 3_600.0, abs=_UNWRITTEN_S)  # and goes on


def test_a_damaged_file_is_begun_anew(tmp_path: Path) -> None:
    wall = _Wall()
    (tmp_path / ".clock").write_bytes(b"\0" * 17)
    assert ActivityClock(tmp_path, wall).now() == wall.at
    wall.at += _DAY
    assert ActivityClock(tmp_path, wall).now() == pytest.approx(wall.at - _DAY + 3_600.0, abs=0.01)


def test_without_a_folder_it_is_the_wall_clock(tmp_path: Path) -> None:
    assert ActivityClock(tmp_path / "none", _Wall(5.0)).now() == 5.0


@pytest.mark.parametrize("passed", [False, True])
def test_the_janitor_takes_no_resumable_upload_for_old_after_a_jump(tmp_path: Path, passed: bool) -> None:
    with closing(open_store(tmp_path)) as store:
        wall = _Wall(time.time() - _DAY)
        clock = ActivityClock(tmp_path, wall)
        store.uploads.add(UploadRecord("up", "k", "", "a.zip", 9, "", clock.now() + 23 * 3_600.0))
        for _ in range(24 if passed else 0):  # a day goes by; otherwise the clock is just set to now
            wall.at += 3_600.0
            clock.now()
        assert (store.jobs.unneeded_uploads(["up"], 0.0)[1] == {"up"}) is passed
        store.jobs.delete_ended(0.0)
        assert (store.uploads.find("up") is None) is passed


def test_the_janitor_takes_no_upload_for_old_that_is_coming_in(tmp_path: Path) -> None:
    blobs = Blobs(tmp_path)
    with UploadSession("up", blobs.upload("up"), CaptureSettings()) as upload:
        upload.write("a.jpg", [b"x"])
        for path in (upload.folder, *upload.folder.rglob("*")):  # the clock is set forward by a day
            os.utime(path, (time.time() - _DAY,) * 2)
        assert blobs.upload_age("up") == 0.0
        upload._end()  # as if its process had died
        assert blobs.upload_age("up") > 23 * 3_600.0
        upload._open = True
