"""Photos become a job through the page, in pieces that go on after a cut; and what becomes of the job."""

from __future__ import annotations

import re
import zipfile
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, Request, Route, expect

from tests.web.browser import visiting
from tests.web.photos import photo, write_photos
from tests.web.places import Place

_PIECE = 8 * 2**20  # as in api/web/src/upload/tus.ts


@pytest.fixture
def photos(tmp_path: Path) -> list[Path]:
    return write_photos(tmp_path, 3)


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A zip of photos that goes in three pieces."""
    path = tmp_path_factory.mktemp("archive") / "capture.zip"
    with zipfile.ZipFile(path, "w") as file:
        number = 0
        while path.stat().st_size < 2.2 * _PIECE:
            file.writestr(f"{number}.jpg", photo(1400, number))
            file.fp.flush() if file.fp else None
            number += 1
    return path


def _choose(page: Page, paths: list[Path]) -> None:
    page.get_by_label("Choose files").set_input_files(paths)


def test_photos_become_a_job_that_is_cancelled_retried_and_deleted(
    place: Place, browser: Browser, photos: list[Path]
) -> None:
    with visiting(browser, place.url, "#/new") as visit:
        page = visit.page
        visit.check_accessible()
        failed: list[str] = []
        page.on("requestfailed", lambda request: failed.append(request.url))
        bad = photos[0].with_name("zz_bad <b>.jpg")
        bad.write_bytes(b"holiday notes")
        unwanted = photos[0].with_name("unwanted.jpg")
        unwanted.write_bytes(b"x")
        _choose(page, [*photos, bad, unwanted])
        expect(page.get_by_text("5 files")).to_be_visible()
        expect(page.get_by_text("5 photos may be too few")).to_be_visible()
        chosen = page.get_by_role("list", name="Chosen files")
        expect(chosen.locator("img")).to_have_count(3)
        expect(chosen.get_by_text("This browser cannot read it")).to_have_count(2)
        page.get_by_role("button", name="Remove unwanted.jpg").click()
        expect(page.get_by_text("4 files")).to_be_visible()
        expect(page.get_by_text("1 photo would add little or nothing.")).to_be_visible()
        expect(page.get_by_text(re.compile(r"Takes about \d+ (s|min) on this server"))).to_be_visible()
        visit.check_accessible()
        page.get_by_label("Name", exact=True).fill("from the page")
        page.get_by_label("Quality").select_option("draft")
        page.get_by_role("button", name="Upload").click()
        expect(page.get_by_role("heading", name="from the page")).to_be_visible()
        expect(page.get_by_text("Waiting for a worker.").last).to_be_visible()
        expect(page.get_by_text("1 file could not be used and is left out")).to_be_visible()
        expect(page.get_by_text("zz_bad <b>.jpg: it is not an image this service can read")).to_be_visible()
        assert [url for url in failed if "/v1/uploads" in url] == []
        visit.check_accessible()
        page.get_by_role("button", name="Cancel the job").click()
        expect(page.get_by_text("The job was cancelled.")).to_be_visible()
        visit.check_accessible()
        page.get_by_role("button", name="Try again").click()
        expect(page.get_by_text("Waiting for a worker.").last).to_be_visible()
        scene_id = page.url.rpartition("/")[2]
        job = place.service._store.scenes.operation(place.service.get_scene(scene_id).operation_id)
        folder = place.service._store.blobs.upload(job.upload_id)
        assert {path.name for path in folder.rglob("*.jpg")} == {"0.jpg", "1.jpg", "2.jpg", bad.name}
        page.get_by_role("button", name="Delete scene").click()
        page.get_by_role("button", name="Delete for good").click()
        expect(page.get_by_role("heading", name="Scenes")).to_be_visible()
        expect(page.get_by_role("link", name="from the page")).to_have_count(0)


def test_an_upload_that_is_cut_goes_on_where_it_stopped(place: Place, browser: Browser, archive: Path) -> None:
    offsets: list[int] = []

    def note(request: Request) -> None:
        if request.method == "PATCH":
            offsets.append(int(request.headers["upload-offset"]))

    with visiting(browser, place.url, "#/new") as visit:
        page = visit.page
        visit.expected.append("ERR_FAILED")
        page.on("request", note)
        cuts = iter([False, True])
        page.route(
            re.compile("/v1/uploads/"),
            lambda route: route.abort() if route.request.method == "PATCH" and next(cuts, False) else route.continue_(),
        )
        _choose(page, [archive])
        page.get_by_role("button", name="Upload").click()
        expect(page.get_by_role("alert")).to_contain_text("What has arrived is kept")
        assert offsets == [0, _PIECE]
        visit.check_accessible()

        page.reload()  # as somebody comes back later
        _choose(page, [archive])
        expect(page.get_by_text("goes on where it stopped")).to_be_visible()
        page.get_by_role("button", name="Upload").click()
        expect(page.get_by_text("Waiting for a worker.").last).to_be_visible()
        assert offsets == [0, _PIECE, _PIECE, 2 * _PIECE]


def test_an_upload_that_is_left_goes_on_and_takes_no_page_over(
    place: Place, browser: Browser, photos: list[Path], tmp_path: Path
) -> None:
    held: list[Route] = []
    (tmp_path / "others").mkdir()
    other_photos = write_photos(tmp_path / "others", 2, 7)
    with visiting(browser, place.url, "#/new") as visit:
        page = visit.page
        page.route("**/v1/uploads/*", lambda route: route.continue_() if held else held.append(route))
        _choose(page, photos)
        page.get_by_label("Name", exact=True).fill("the first")
        page.get_by_role("checkbox", name="Keep people out").press("Space")
        with page.expect_request(lambda request: request.method == "PATCH"):
            page.get_by_role("button", name="Upload").click()
        page.get_by_role("link", name="Scenes").click()
        note = page.get_by_role("region", name="Upload of “the first”")
        expect(note.get_by_role("progressbar")).to_be_visible()
        visit.check_accessible()
        page.get_by_role("link", name="New scene").first.click()
        _choose(page, other_photos)
        expect(page.get_by_text("2 files,")).to_be_visible()
        held[0].continue_()
        expect(note.get_by_role("status")).to_have_text(re.compile("“the first” has been sent"))
        expect(page.get_by_text("2 files,")).to_be_visible()
        assert page.url.endswith("#/new")
        visit.check_accessible()
        note.get_by_role("link").click()
        expect(page.get_by_role("heading", name="the first")).to_be_visible()
        expect(note).to_have_count(0)
        scene = place.service.get_scene(page.url.rpartition("/")[2])
        assert place.service._store.scenes.operation(scene.operation_id).options["privacy"] == "people"


def test_what_cannot_be_sent_is_said_before_it_is(place: Place, browser: Browser, tmp_path: Path) -> None:
    names = {"a.splat": bytes(32), "a.gif": b"x", "notes <b>.docx": b"x", "empty.jpg": b"", "good.jpg": photo(32, 1)}
    for name, content in names.items():
        (tmp_path / name).write_bytes(content)
    with visiting(browser, place.url, "#/new") as visit:
        _choose(visit.page, [tmp_path / name for name in names])
        alert = visit.page.get_by_role("alert")
        for name in ("a.gif", "notes <b>.docx", "empty.jpg"):
            expect(alert).to_contain_text(name)
        expect(visit.page.get_by_text("2 files,")).to_be_visible()
        visit.check_accessible()
        assert not [url for url in visit.requests if "/v1/uploads/" in url]
