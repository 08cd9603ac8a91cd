"""A job is watched on the page: pictures and cameras as they come, time left, who works on it, an early end."""

from __future__ import annotations

import re

import pytest
from playwright.sync_api import Browser, Route, expect

from fastsplat.service.store.queue.claims import Claim
from tests.api.training_job import add_training_job, make_old, show_training
from tests.web.browser import PHONE, visiting
from tests.web.places import Place

_PICTURE = "The scene as it is trained so far"


@pytest.fixture
def training(place: Place) -> Claim:
    """A job that trains, as far as the server can tell."""
    return add_training_job(place.service, "<i>grows</i>")


def test_a_scene_is_seen_growing_without_being_asked_for_again_and_again(
    place: Place, browser: Browser, training: Claim
) -> None:
    with visiting(browser, place.url, f"#/scenes/{training.operation.scene_id}") as visit:
        page = visit.page
        picture = page.get_by_role("img", name=_PICTURE)
        expect(picture).to_have_attribute("data-step", "300")
        assert picture.evaluate("image => [image.naturalWidth, image.naturalHeight]") == [32, 24]
        expect(page.get_by_text("300 steps, 4 s · 1,000 Gaussians · 21.0 dB PSNR")).to_be_visible()
        expect(page.get_by_text("About 3 min left in all.")).to_be_visible()
        expect(page.get_by_role("progressbar", name="Training")).to_have_attribute("value", "0.25")
        expect(page.get_by_text(re.compile(r"about \d+ s left in this stage$"))).to_be_visible()
        expect(page.get_by_role("heading", name="<i>grows</i>")).to_be_visible()

        cameras = page.get_by_role("img", name="Drawing of the cameras of 2 of 3 photos, and points")
        expect(cameras).to_have_attribute("data-cameras", "2")
        expect(cameras).to_have_attribute("data-points", "200")
        for element in (picture, page.get_by_role("progressbar", name="Training")):
            expect(element).to_be_in_viewport(ratio=0.9)  # both at once
        colors = "canvas => canvas.getContext('2d').getImageData(0, 0, 640, 640).data.filter(value => value).length"
        before = cameras.evaluate("canvas => canvas.toDataURL()")
        assert cameras.evaluate(colors) > 1_000
        page.get_by_role("button", name="Turn left").press("Enter")
        both = [cameras.element_handle(), before]
        page.wait_for_function("([canvas, before]) => canvas.toDataURL() !== before", arg=both)
        visit.check_accessible()

        for number in (2, 3):
            show_training(place.service, training, number)
            expect(picture).to_have_attribute("data-step", str(300 * number))
        polls = [url for url in visit.requests if url.endswith(f"/operations/{training.operation.id}")]
        assert len(polls) <= 1  # the rest came as events
        assert any(url.endswith("/events") for url in visit.requests)


def test_a_training_is_stopped_early_and_kept_by_keyboard(place: Place, browser: Browser, training: Claim) -> None:
    with visiting(browser, place.url, f"#/scenes/{training.operation.scene_id}", **PHONE, color_scheme="dark") as visit:
        page = visit.page
        expect(page.get_by_role("button", name="Turn right")).to_be_visible()
        assert visit.fits()
        page.get_by_role("button", name="Stop early and keep it").press("Enter")
        visit.check_accessible()
        assert not place.service.get_operation(training.operation.id).finish_requested
        page.get_by_role("button", name="Stop and keep").press("Enter")
        expect(page.get_by_text("The training is ending")).to_be_visible()
        assert place.service.get_operation(training.operation.id).finish_requested
        assert place.service._store.jobs.check(training) == {"finish"}


def test_where_events_break_off_the_page_asks_instead(place: Place, browser: Browser, training: Claim) -> None:
    with visiting(browser, place.url) as visit:
        visit.expected.append("ERR_FAILED")
        visit.page.route("**/events", lambda route: route.abort())
        visit.page.goto(f"{place.url}/#/scenes/{training.operation.scene_id}")
        picture = visit.page.get_by_role("img", name=_PICTURE)
        expect(picture).to_have_attribute("data-step", "300")
        show_training(place.service, training, 2)
        expect(picture).to_have_attribute("data-step", "600")


def test_a_dead_worker_is_shown_and_that_the_job_went_on(place: Place, browser: Browser, training: Claim) -> None:
    workers, job = place.service._store.workers, training.operation.id
    with visiting(browser, place.url, f"#/scenes/{training.operation.scene_id}") as visit:
        page = visit.page
        expect(page.get_by_role("img", name=_PICTURE)).to_be_visible()
        workers.update_heartbeat("another", "a machine", 1)
        make_old(place.service, job)
        expect(page.get_by_text("The worker of this job has stopped answering.")).to_be_visible()
        workers.unregister("another")
        expect(page.get_by_text("No worker is running on the server")).to_be_visible()
        visit.check_accessible()
        again = place.service._store.jobs.claim(job)
        expect(page.get_by_text("Attempt 2: its worker stopped without warning")).to_be_visible()
        show_training(place.service, again, 4)
        expect(page.get_by_role("img", name=_PICTURE)).to_have_attribute("data-step", "1200")


def test_a_cancelled_job_says_so_and_nothing_else_when_it_is_tried_again(
    place: Place, browser: Browser, training: Claim
) -> None:
    jobs = place.service._store.jobs
    place.service._store.blobs.upload(training.operation.upload_id).mkdir(parents=True, exist_ok=True)
    with visiting(browser, place.url, f"#/scenes/{training.operation.scene_id}") as visit:
        page = visit.page
        page.get_by_role("button", name="Cancel the job").click()
        jobs.cancelled(training)
        expect(page.get_by_text("The job was cancelled.")).to_be_visible()
        stages = page.locator(".stages")
        expect(stages).to_contain_text("took 12 s")
        assert "so far" not in stages.inner_text() and page.get_by_text("Waiting for a worker.").count() == 0
        page.get_by_role("button", name="Try again", exact=True).click()
        expect(page.get_by_text("Waiting for a worker.").first).to_be_visible()
        jobs.claim(training.operation.id)
        expect(page.get_by_text("Attempt 2: the job was cancelled")).to_be_visible()
        assert page.get_by_text("without warning").count() == 0


def test_of_a_failed_job_the_first_offer_is_what_would_mend_it(place: Place, browser: Browser, training: Claim) -> None:
    jobs, job = place.service._store.jobs, training.operation.id
    details = {"field": "images", "limit": "3 photos", "hint": "Take more photos."}
    error = {"kind": "FAILED_PRECONDITION", "reason": "RECONSTRUCTION_FAILED", "stage": "capture", "details": details}
    blamed = {**error, "message": "IMG_0012.jpg fits nowhere", "recurs": True, "photos": ["IMG_0012.jpg"]}
    jobs.fail(training, blamed)
    bodies: list[object] = []
    with visiting(browser, place.url) as visit:
        page = visit.page

        def refuse(route: Route) -> None:
            bodies.append(route.request.post_data_json)
            route.abort()

        visit.expected.append("ERR_FAILED")
        page.route(f"**/operations/{job}:retry", refuse)
        page.goto(f"{place.url}/#/scenes/{training.operation.scene_id}")
        texts = ("Failed in the stage “Photos and cameras”.", "fits nowhere.", "Limit: 3 photos.", "Take more photos.")
        for text in texts:
            expect(page.get_by_role("alert")).to_contain_text(text)
        offers = page.locator(".job .buttons").locator("button, a")
        expect(offers.first).to_have_text("Leave out IMG_0012.jpg and go on")
        expect(offers.nth(1)).to_have_text("Try again with the same photos")
        offers.first.click()
        expect(page.get_by_role("alert").last).to_be_visible()
        assert bodies == [{"exclude": ["IMG_0012.jpg"]}]
        visit.check_accessible()
        for more, offer in (({"recurs": True}, "Choose other photos"), ({"recurs": False}, "Try again")):
            jobs.retry(job, 0.0)
            claim = jobs.claim(job)
            jobs.fail(claim, {**error, "message": "it failed", **more})
            page.reload()
            expect(offers.first).to_have_text(offer)
        page.goto(f"{place.url}/#/")
        expect(page.get_by_role("link", name="<i>grows</i>")).to_contain_text("Failed")
