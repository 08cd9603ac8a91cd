"""The place is run on the page: what the server can do, jobs, keys, known names; nobody sees more than the role may."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser, Page, expect

from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.settings import QuotaSettings
from fastsplat_contract.keys import Role
from tests.api.made_scene import add_known_name
from tests.api.served import serving
from tests.scenes import queued_job
from tests.web.browser import Visit, visiting
from tests.web.conftest import MARKUP, page_settings
from tests.web.table import add_table


@pytest.fixture(scope="module")
def guarded(browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, SceneService]]:
    """The address of a server that wants keys, and the service below."""
    settings = page_settings(tmp_path_factory.mktemp("run"), auth="on", quotas=QuotaSettings(scenes=2))
    with open_service(settings) as service, serving(service, settings) as ports:
        add_table(service, settings)
        yield f"http://127.0.0.1:{ports.http}", service


def _signed_in(visit: Visit, service: SceneService, role: Role) -> Page:
    visit.expected.append("401")
    visit.page.get_by_label("Access key").fill(service.admin.keys.create(f"a {role}", role)[1])
    visit.page.get_by_role("button", name="Sign in").click()
    visit.page.get_by_role("link", name="Server").click()
    expect(visit.page.get_by_role("heading", name="What it can do")).to_be_visible()
    return visit.page


def test_an_admin_makes_a_key_that_is_shown_once_and_revokes_it(
    guarded: tuple[str, SceneService], browser: Browser
) -> None:
    url, service = guarded
    with visiting(browser, url) as visit:
        page = _signed_in(visit, service, "admin")
        expect(page.get_by_text("No worker is alive, so jobs wait.")).to_be_visible()
        expect(page.get_by_text("not calibrated: answers have no probabilities")).to_be_visible()
        visit.check_accessible()
        page.get_by_label("Whose key it is").fill(MARKUP)
        page.get_by_label("What it may do").select_option("reader")
        assert page.get_by_label("What it may do").locator("option").count() == 3  # no operator's
        page.get_by_label("It expires").select_option("day")
        page.get_by_role("button", name="Make a key").click()
        secret = page.get_by_label("New key").input_value()
        (made,) = [key for key in service.keys.list("operator").keys if key.name == MARKUP]
        assert (made.role, made.state) == ("reader", "VALID") and made.expires_at is not None
        stored = service.admin.keys.valid().find(secret)
        assert stored is not None and stored.id == made.id
        visit.check_accessible()
        page.get_by_role("button", name="I have stored it").click()
        expect(page.get_by_label("New key")).to_have_count(0)
        page.get_by_role("button", name=f"Revoke the key {MARKUP}").click()
        page.get_by_role("button", name="Revoke for good").click()
        expect(page.get_by_role("listitem").filter(has_text=MARKUP)).to_have_count(0)
        assert service.admin.keys.valid().find(secret) is None
        page.get_by_label("Show expired and revoked keys, too").check()
        expect(page.get_by_role("listitem").filter(has_text=MARKUP)).to_contain_text("Revoked")
        page.get_by_label("Whose key it is").fill("x" * 10_000)
        assert len(page.get_by_label("Whose key it is").input_value()) <= 10_000
        visit.expected.append("400")
        page.get_by_label("Whose key it is").evaluate("element => element.removeAttribute('maxlength')")
        page.get_by_label("Whose key it is").fill("x" * 10_000)
        page.get_by_role("button", name="Make a key").click()
        expect(page.get_by_role("alert")).to_contain_text("too long")


def test_jobs_are_cancelled_and_retried_from_the_list(guarded: tuple[str, SceneService], browser: Browser) -> None:
    url, service = guarded
    job = queued_job(f"job {MARKUP}")
    service._store.scenes.create(job)
    service._store.blobs.upload(job.upload_id).mkdir(parents=True)
    with visiting(browser, url, viewport={"width": 390, "height": 844}) as visit:
        page = _signed_in(visit, service, "editor")
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
    service.delete_scene(job.scene_id)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_reader_looks_and_changes_nothing(guarded: tuple[str, SceneService], browser: Browser, scheme: str) -> None:
    url, service = guarded
    name_id = add_known_name(service, service.list_scenes().scenes[-1].id, MARKUP)
    with visiting(browser, url, color_scheme=scheme) as visit:
        page = _signed_in(visit, service, "reader")
        expect(page.get_by_role("link", name=MARKUP)).to_be_visible()
        expect(page.get_by_role("main").get_by_role("button")).to_have_count(0)
        visit.check_accessible()
        assert not [address for address in visit.requests if "/v1/keys" in address]
    service.known_names.forget(name_id)


def test_an_admin_lets_a_known_name_be_forgotten(guarded: tuple[str, SceneService], browser: Browser) -> None:
    url, service = guarded
    add_known_name(service, service.list_scenes().scenes[-1].id, MARKUP)
    with visiting(browser, url) as visit:
        page = _signed_in(visit, service, "admin")
        page.get_by_role("button", name=f"Forget {MARKUP}").click()
        expect(page.get_by_text("Nobody has named anything yet.")).to_be_visible()
    assert service.known_names.list().names == ()
