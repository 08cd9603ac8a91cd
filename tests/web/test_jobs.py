"""A job on the page: its stages with the time that is left, and why it failed."""

from __future__ import annotations

import re

from playwright.sync_api import Browser, expect

from tests.scenes import queued_job
from tests.web.browser import visiting
from tests.web.places import Place


def test_stages_are_shown_as_they_run_and_a_failure_with_its_hint(place: Place, browser: Browser) -> None:
    store, job = place.service._store, queued_job("a job")
    store.scenes.create(job)
    claim = store.jobs.claim(job.operation_id)
    assert claim is not None
    done = {"stage": "capture", "fraction": 1.0, "message": "26 photos", "seconds": 12.0, "metrics": {}}
    half = {"stage": "training", "fraction": 0.25, "message": "step 100 <b>", "seconds": 30.0, "metrics": {}}
    store.jobs.report(claim, [done, half])
    with visiting(browser, place.url, f"#/scenes/{job.scene_id}") as visit:
        page = visit.page
        expect(page.get_by_role("progressbar", name="Training")).to_have_attribute("value", "0.25")
        expect(page.get_by_text(re.compile(r"^step 100 <b> · about \d+ (s|min) left in this stage$"))).to_be_visible()
        visit.check_accessible()
        details = {"field": "images", "limit": "3 photos", "hint": "Take more photos."}
        error = {"kind": "INVALID_ARGUMENT", "reason": "INVALID_INPUT", "message": "too few photos", "details": details}
        store.jobs.fail(claim, {**error, "stage": "training"})
        expect(page.get_by_role("alert")).to_contain_text("Failed in the stage “Training”.")
        for text in ("Too few photos.", "Limit: 3 photos.", "Take more photos."):
            expect(page.get_by_role("alert")).to_contain_text(text)
        expect(page.get_by_role("button", name="Try again")).to_be_visible()
        visit.check_accessible()
        page.goto(f"{place.url}/#/")
        expect(page.get_by_role("link", name="a job")).to_contain_text("Failed")
