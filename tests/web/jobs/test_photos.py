"""What became of each photo, on the page of the scene and of its job."""

from __future__ import annotations

from playwright.sync_api import Browser, expect

from fastsplat_contract.codec.json_codec import to_plain
from fastsplat_contract.photos.photo_verdicts import PhotoVerdict
from tests.scenes import finish_job, queued_job
from tests.web.browser import PHONE, visiting
from tests.web.places import MARKUP, Place
from tests.web.table import table

_SHAKEN = PhotoVerdict(f"{MARKUP}.jpg", False, "few_matches", ("blurred",), "", 0.3, 0.8, 9, "Hold the camera still.")
_TWICE = PhotoVerdict("2.jpg", True, None, ("duplicate",), "3.jpg", 1.0, 0.8, 400, "It shows the same as 3.jpg.")
_GOOD = PhotoVerdict("3.jpg", True, None, (), "", 1.0, 0.8, 400, "")


def test_verdicts_are_there_during_the_job_and_stay_with_the_scene(place: Place, browser: Browser) -> None:
    store, job = place.service._store, queued_job("with photos")
    store.scenes.create(job)
    claim = store.jobs.claim(job.operation_id)
    running = {"stage": "capture", "fraction": 0.5, "message": "", "seconds": 1.0, "metrics": {}}
    store.jobs.report(claim, [running])
    with visiting(browser, place.url, f"#/scenes/{job.scene_id}", **PHONE) as visit:
        page = visit.page
        expect(page.get_by_role("progressbar", name="Photos and cameras")).to_be_visible()
        expect(page.get_by_role("heading", name="Photos", exact=True)).to_have_count(0)
        store.jobs.record_photos(claim, [to_plain(verdict) for verdict in (_SHAKEN, _TWICE, _GOOD)])
        store.jobs.report(claim, [{**running, "fraction": 1.0}])
        expect(page.get_by_text("2 of 3 photos placed. 2 photos need a look.")).to_be_visible()
        photos = page.locator(".photo-list > li")
        expect(photos).to_have_count(2)
        expect(photos.first).to_contain_text(f"{MARKUP}.jpg")
        for text in ("Not placed: too few matches", "Blurred", "Hold the camera still."):
            expect(photos.first).to_contain_text(text)
        expect(photos.last).to_contain_text("Duplicate")
        page.get_by_label("Show all photos").check()
        expect(photos).to_have_count(3)
        visit.check_accessible()
        assert visit.fits()
    store.jobs.release(claim)
    finish_job(store, job.operation_id, table(place.settings))
    with visiting(browser, place.url, f"#/scenes/{job.scene_id}", color_scheme="dark") as visit:
        expect(visit.tab("Photos").locator(".photo-list > li")).to_have_count(2)
        visit.check_accessible()


def test_a_scene_of_an_earlier_release_says_that_nothing_was_recorded(place: Place, browser: Browser) -> None:
    with visiting(browser, place.url, f"#/scenes/{place.scene_id}") as visit:
        expect(visit.tab("Photos").get_by_text("What became of its photos was not recorded.")).to_be_visible()
