"""The place is run on the page: what the server can do, jobs, keys, known names; nobody sees more than the role may."""

from __future__ import annotations

import re

from playwright.sync_api import Browser, Page, expect
from sqlalchemy import update

from fastsplat.service.store.rows.database import transaction
from fastsplat.service.store.rows.schema import workers
from fastsplat_contract.server.keys import Role
from tests.api.made_scene import add_known_name
from tests.scenes import queued_job
from tests.web.browser import PHONE, Visit, visiting
from tests.web.places import MARKUP, Place


def _signed_in(visit: Visit, guarded: Place, role: Role) -> Page:
    visit.sign_in(guarded.new_key(role))
    visit.page.get_by_role("link", name="Server").click()
    expect(visit.page.get_by_role("heading", name="What it can do")).to_be_visible()
    return visit.page


def test_an_admin_makes_a_key_that_is_shown_once_and_revokes_it(guarded: Place, browser: Browser) -> None:
    service = guarded.service
    with visiting(browser, guarded.url) as visit:
        page = _signed_in(visit, guarded, "admin")
        expect(page.get_by_text("No worker is alive, so jobs wait.")).to_be_visible()
        expect(page.get_by_text("not calibrated: its scores are no probabilities")).to_have_count(2)
        expect(page.get_by_text("Jobs of all projects")).to_have_count(0)  # an operator's
        visit.check_accessible()
        page.get_by_label("Whose key it is").fill(MARKUP)
        page.get_by_label("What it may do").select_option("reader")
        assert page.get_by_label("What it may do").locator("option").count() == 4  # no operator's
        page.get_by_label("It expires").select_option("day")
        page.get_by_role("button", name="Make a key").click()
        secret = page.get_by_label("New key").input_value()
        (new_key,) = [key for key in service.keys.list("operator").keys if key.name == MARKUP]
        assert (new_key.role, new_key.state) == ("reader", "VALID") and new_key.expires_at is not None
        stored = service.admin.keys.valid().find(secret)
        assert stored is not None and stored.id == new_key.id
        visit.check_accessible()
        page.get_by_role("button", name="I have stored it").click()
        expect(page.get_by_label("New key")).to_have_count(0)
        page.get_by_role("button", name=f"Revoke the key {MARKUP}").click()
        page.get_by_role("button", name="Revoke for good").click()
        expect(page.get_by_role("listitem").filter(has_text=MARKUP)).to_have_count(0)
        assert service.admin.keys.valid().find(secret) is None
        page.get_by_label("Show expired and revoked keys, too").check()
        expect(page.get_by_role("listitem").filter(has_text=MARKUP)).to_contain_text("Revoked")
        visit.expected.append("400")
        page.get_by_label("Whose key it is").evaluate("element => element.removeAttribute('maxlength')")
        page.get_by_label("Whose key it is").fill("x" * 10_000)
        page.get_by_role("button", name="Make a key").click()
        expect(page.get_by_role("alert")).to_contain_text("too long")


def test_an_operator_sees_which_worker_fell_silent_what_waits_and_the_disk(guarded: Place, browser: Browser) -> None:
    store = guarded.service._store
    store.workers.update_heartbeat("silent", "kitchen-machine", 77)
    with transaction(store.engine) as connection:
        connection.execute(update(workers).where(workers.c.executor_id == "silent").values(heartbeat_at=1.0))
    try:
        with visiting(browser, guarded.url) as visit:
            page = _signed_in(visit, guarded, "operator")
            expect(page.get_by_text("process 77 of kitchen-machine: nothing heard for")).to_be_visible()
            expect(page.get_by_text("Jobs of all projects")).to_be_visible()
            expect(page.locator("dd").filter(has_text=re.compile(r"^[0-9].* of .* free$"))).to_have_count(1)
            visit.check_accessible()
    finally:
        store.workers.unregister("silent")


def test_jobs_are_cancelled_and_retried_from_the_list(guarded: Place, browser: Browser) -> None:
    service = guarded.service
    job = queued_job(f"job {MARKUP}")
    service._store.scenes.create(job)
    service._store.blobs.upload(job.upload_id).mkdir(parents=True)
    with visiting(browser, guarded.url, **PHONE) as visit:
        page = _signed_in(visit, guarded, "editor")
        expect(page.get_by_role("heading", name="Access keys")).to_have_count(0)
        row = page.get_by_role("list", name="Jobs").get_by_role("listitem").filter(has_text="job ")
        expect(row).to_contain_text(MARKUP)
        expect(row).to_contain_text("Waiting")
        row.get_by_role("button", name="Cancel the job").click()
        expect(row).to_contain_text("Cancelled")
        assert service.get_operation(job.operation_id).state == "CANCELLED"
        row.get_by_role("button", name="again").click()
        expect(row).to_contain_text("Waiting")
        assert service.get_operation(job.operation_id).state == "QUEUED"
        visit.check_accessible()
        assert visit.fits()


def test_a_reader_looks_and_changes_nothing(guarded: Place, browser: Browser) -> None:
    service = guarded.service
    name_id = add_known_name(service, guarded.scene_id, MARKUP)
    with visiting(browser, guarded.url) as visit:
        page = _signed_in(visit, guarded, "reader")
        expect(page.get_by_role("link", name=MARKUP)).to_be_visible()
        expect(page.get_by_role("main").get_by_role("button")).to_have_count(0)
        visit.check_accessible()
        assert not [address for address in visit.requests if "/v1/keys" in address]
    service.known_names.forget(name_id)


def test_an_admin_lets_a_known_name_be_forgotten(guarded: Place, browser: Browser) -> None:
    service = guarded.service
    add_known_name(service, guarded.scene_id, MARKUP)
    with visiting(browser, guarded.url) as visit:
        page = _signed_in(visit, guarded, "admin")
        page.get_by_role("button", name=f"Forget {MARKUP}").click()
        expect(page.get_by_text("Nobody has named anything yet.")).to_be_visible()
    assert service.known_names.list().names == ()
