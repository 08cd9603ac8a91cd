"""The list of scenes: what there is, in which state, and what is wrong."""

from __future__ import annotations

from playwright.sync_api import Browser, expect

from fastsplat_contract.jobs.job_watching import Provisional
from tests.scenes import finish_job, queued_job
from tests.web.browser import visiting
from tests.web.places import Place
from tests.web.table import table


def test_scenes_have_pictures_and_states(place: Place, browser: Browser) -> None:
    store, draft, job = place.service._store, queued_job("half done"), queued_job("in the queue")
    store.scenes.create(draft)
    row = {"stage": "training", "fraction": 0.3, "message": "", "seconds": 9.0, "metrics": {"job_seconds_left": 200.0}}
    made_of = Provisional("points", 0.0)
    finish_job(store, draft.operation_id, table(place.settings), version="draft", stages=[row], draft=made_of)
    store.scenes.create(job)
    store.scenes.create(queued_job("at the end"))
    store.workers.update_heartbeat("one", "a machine", 1)
    with visiting(browser, place.url) as visit:
        card = visit.page.get_by_role("link", name="a table")
        expect(card.get_by_role("img", name="Picture of a table").first).to_be_visible()
        expect(card.first).to_contain_text("Ready")
        expect(card.first).to_contain_text("3 objects: ")
        expect(visit.page.get_by_role("img", name="Picture of half done")).to_be_visible()
        for name, ahead in (("in the queue", "1 job is ahead, about 3 min."), ("at the end", "2 jobs are ahead.")):
            expect(visit.page.get_by_role("link", name=name)).to_contain_text(f"Waiting for a worker. {ahead}")
        visit.check_accessible()
        visit.page.goto(f"{place.url}/#/scenes/{draft.scene_id}")
        note = visit.page.get_by_role("complementary", name="Provisional.")
        expect(note.get_by_text("About 3 min left in all.")).to_be_visible()
        expect(note.get_by_role("button", name="Cancel the job")).not_to_be_visible()  # in the closed section
    store.workers.unregister("one")


def test_scenes_are_found_by_name_and_by_the_objects_in_them(place: Place, browser: Browser) -> None:
    workshop_id = place.new_scene("workshop")
    with visiting(browser, place.url) as visit:
        page, cards = visit.page, visit.page.get_by_role("list", name="Scenes").get_by_role("link")
        expect(cards).to_have_count(2)
        page.get_by_label("Sort by").select_option("By name")
        expect(cards.first).to_contain_text("a table")
        field = page.get_by_role("searchbox")
        field.fill("work")
        expect(cards).to_have_count(1)
        expect(cards.first).to_contain_text("workshop")
        field.fill("ball")
        expect(page.get_by_text("No scene is called “ball”.")).to_be_visible()
        field.press("Enter")
        found = page.get_by_role("region", name="“ball”: in 2 of 2 scenes")
        expect(found.get_by_role("link")).to_have_count(2)
        expect(found.locator("img")).to_have_count(2)
        visit.check_accessible()
        found.get_by_role("link", name="workshop").click()
        expect(page.locator(".verdict.here")).to_be_visible()
        assert f"#/scenes/{workshop_id}?q=ball" in page.url


def test_several_scenes_are_deleted_at_once(place: Place, browser: Browser) -> None:
    for name in ("one", "two", "three"):
        place.new_scene(name)
    with visiting(browser, place.url) as visit:
        page = visit.page
        page.get_by_role("button", name="Select", exact=True).click()
        for name in ("one", "two", "three"):
            page.get_by_role("checkbox", name=f"Select {name}").check()
        page.get_by_role("checkbox", name="Select two").uncheck()
        page.get_by_role("button", name="Delete 2 scenes").click()
        expect(page.get_by_text("Delete “three”, “one”?")).to_be_visible()
        visit.check_accessible()
        page.get_by_role("button", name="Delete for good").click()
        expect(page.get_by_role("list", name="Scenes").get_by_role("link")).to_have_count(2)
        assert {scene.name for scene in place.service.list_scenes().scenes} == {"a table", "two"}


def test_a_server_that_cannot_be_reached_is_said_and_comes_back(place: Place, browser: Browser) -> None:
    with visiting(browser, place.url) as visit:
        visit.expected.append("ERR_INTERNET_DISCONNECTED")
        visit.expected.append("ERR_FAILED")
        expect(visit.page.get_by_role("link", name="a table").first).to_be_visible()
        visit.page.route("**/v1/**", lambda route: route.abort())
        visit.page.goto(f"{place.url}/#/scenes/{place.scene_id}")
        expect(visit.page.get_by_text("The server cannot be reached. This page tries again by itself.")).to_be_visible()
        visit.check_accessible()
        visit.page.unroute("**/v1/**")
        expect(visit.page.get_by_role("heading", name="a table")).to_be_visible()
        expect(visit.page.get_by_text("This page tries again by itself.")).to_be_hidden()


def test_a_scene_that_is_not_good_says_so_with_the_reason_and_the_advice(place: Place, browser: Browser) -> None:
    with visiting(browser, place.url) as visit:
        visit.page.goto(f"{place.url}/#/scenes/{place.scene_id}")
        note = visit.page.get_by_role("region", name="How good this scene is")
        expect(note).to_contain_text("A poor scene")
        assessment = place.service.get_scene(place.scene_id).assessment
        assert [finding.reason for finding in assessment.findings] == ["FEW_PHOTOS"]
        for finding in assessment.findings:
            expect(note).to_contain_text(f"{finding.message} {finding.advice}")
        visit.check_accessible()
