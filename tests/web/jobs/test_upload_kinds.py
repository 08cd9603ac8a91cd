"""What may be brought through the page, and what is refused before a byte is sent."""

from __future__ import annotations

import tarfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Browser, Page, expect

from fastsplat.service.application.service import SceneService
from tests.capture.upload_files import video_file
from tests.web.browser import PHONE, visiting
from tests.web.photos import write_photos
from tests.web.places import Place


def _files_of(service: SceneService, scene_id: str) -> set[str]:
    operation = service._store.scenes.operation(service.get_scene(scene_id).operation_id)
    folder = service._store.blobs.upload(operation.upload_id)
    return {path.name for path in folder.rglob("*") if path.is_file() and path.suffix != ".json"}


def _post(page: Page, place: Place) -> str:
    page.get_by_role("button", name="Upload").click()
    expect(page.get_by_text("Waiting for a worker.").last).to_be_visible()
    return page.url.rpartition("/")[2]


def _folder(folder: Path) -> tuple[str, list[Path] | Path, set[str]]:
    (folder / "room" / ".hidden").mkdir(parents=True)
    write_photos(folder / "room", 3)
    (folder / "room/.hidden/x.jpg").write_bytes(b"x")
    return "Choose a folder", folder / "room", {"0.jpg", "1.jpg", "2.jpg"}


def _video(folder: Path) -> tuple[str, list[Path] | Path, set[str]]:
    frames = np.random.default_rng(0).integers(0, 255, (12, 48, 64, 3), dtype=np.uint8)
    video_file(folder / "walk.mp4", frames, "mp4v")
    return "Choose files", [folder / "walk.mp4"], {"walk.mp4"}


def _archive(folder: Path) -> tuple[str, list[Path] | Path, set[str]]:
    with tarfile.open(folder / "capture.tar.gz", "w:gz") as archive:
        for path in write_photos(folder, 3):
            archive.add(path, path.name)
    return "Choose files", [folder / "capture.tar.gz"], {"0.jpg", "1.jpg", "2.jpg"}


@pytest.mark.parametrize("make", [_folder, _video, _archive])
def test_each_kind_of_capture_becomes_a_job(
    place: Place, browser: Browser, tmp_path: Path, make: Callable[[Path], tuple[str, list[Path] | Path, set[str]]]
) -> None:
    button, files, names = make(tmp_path)
    with visiting(browser, place.url, "#/new") as visit:
        visit.page.get_by_label(button).set_input_files(files)
        scene_id = _post(visit.page, place)
    assert names <= _files_of(place.service, scene_id)


def test_a_full_quota_is_said_before_anything_is_sent(small: Place, browser: Browser, tmp_path: Path) -> None:
    with visiting(browser, small.url, "#/new") as visit:
        visit.page.get_by_label("Choose files").set_input_files(write_photos(tmp_path, 3))
        _post(visit.page, small)
    with visiting(browser, small.url, "#/new", **PHONE) as visit:
        expect(visit.page.get_by_role("alert")).to_contain_text("as many scenes as it may")
        visit.page.get_by_label("Choose files").set_input_files(write_photos(tmp_path, 3))
        expect(visit.page.get_by_role("button", name="Upload")).to_be_disabled()
        visit.check_accessible()
        assert visit.fits()
        assert not [address for address in visit.requests if "/v1/uploads" in address]
        visit.page.get_by_role("link", name="See what the project holds").click()
        expect(visit.page.get_by_text("1 of 1", exact=True)).to_be_visible()
    assert len(small.service.list_scenes().scenes) == 1


def test_what_the_project_or_the_server_has_no_room_for_is_said_before_it_is_sent(
    small: Place, browser: Browser, tmp_path: Path
) -> None:
    photos = write_photos(tmp_path, 7)
    large = tmp_path / "large.jpg"
    large.write_bytes(photos[0].read_bytes() + b"\0" * 45_000)
    larger = tmp_path / "larger.jpg"
    larger.write_bytes(photos[0].read_bytes() + b"\0" * 65_000)
    with visiting(browser, small.url, "#/new") as visit:
        expect(visit.page.get_by_role("heading", name="Take them with your phone")).to_be_visible()
        for files, words in (([large], "45.0 kB left"), ([larger], "more than the server takes"), (photos, "7 images")):
            visit.page.get_by_label("Choose files").set_input_files(files)
            expect(visit.page.get_by_role("alert")).to_contain_text(words)
            expect(visit.page.get_by_role("button", name="Upload")).to_be_disabled()
            visit.page.get_by_role("button", name="Clear").click()
        assert not [address for address in visit.requests if "/v1/uploads" in address]
    assert small.service.list_scenes().scenes == ()
