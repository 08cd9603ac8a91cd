"""The page says to which host pictures of objects would go, takes the project's agreement, and asks."""

from __future__ import annotations

from pathlib import Path

from playwright.sync_api import Browser, expect

from fastsplat.service.settings import CaptionerSettings
from fastsplat_contract.codec.json_codec import to_plain
from fastsplat_contract.jobs.name_suggestions import CaptionerResult
from fastsplat_contract.messages.scenes import Edit
from tests.client.replay_captioner import replayed
from tests.web.browser import visiting
from tests.web.places import page_settings, running


def test_the_host_is_named_agreed_to_asked_and_the_agreement_taken_back(browser: Browser, tmp_path: Path) -> None:
    with replayed([], lambda _: {"names": []}) as captioner:
        settings = page_settings(tmp_path, captioner=CaptionerSettings(url=captioner.url, model="eyes:7b"))
        host = settings.captioner.host
        with running(settings) as place:
            scene_id = place.new_scene("own")
            ids = [obj.id for obj in place.service.answers.list_objects(scene_id).objects]
            place.service.versions.edit(scene_id, [Edit("unname", object_ids=tuple(ids))])
            with visiting(browser, place.url, f"#/scenes/{scene_id}") as visit:
                visit.scene_shown()
                objects = visit.tab("Objects")
                expect(objects).to_contain_text(f"eyes:7b at {host} can suggest names")
                expect(objects).to_contain_text("Nothing is sent before the project agrees.")
                expect(objects.get_by_role("button", name="Ask eyes:7b")).to_have_count(0)
                visit.check_accessible()
                objects.get_by_role("button", name=f"Agree to send pictures to {host}").click()
                objects.get_by_role("button", name="Ask eyes:7b").wait_for()
                assert not captioner.got
                objects.get_by_role("button", name="Ask eyes:7b").click()
                note = objects.locator("[role=status]")
                expect(note).to_contain_text("Waiting for a worker.")
                visit.check_accessible()
                (job,) = [job for job in place.service.list_operations().operations if job.kind == "ask_captioner"]
                claim = place.service._store.jobs.claim(job.id)
                result = CaptionerResult(3, 4, 1, "", place.service.get_scene(scene_id).version)
                place.service._store.jobs.succeed_with_version(claim, None, to_plain(result))
                expect(note).to_contain_text("3 names suggested for 4 objects. 1 name was refused.")
                visit.check_accessible()
                assert not captioner.got, "a worker asks"
                objects.get_by_role("button", name="Take the agreement back").click()
                expect(objects.get_by_role("button", name=f"Agree to send pictures to {host}")).to_be_visible()
            assert not any(obj.name for obj in place.service.answers.list_objects(scene_id).objects)
