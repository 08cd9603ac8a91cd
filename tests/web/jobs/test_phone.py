"""A link for one upload, read from its QR code: what the phone that opens it may do, and what not."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
from playwright.sync_api import Browser, expect

from fastsplat_contract.messages.scenes import SceneSummary
from fastsplat_contract.server.keys import UploadKeyIn
from tests.web.browser import PHONE, Visit, visiting
from tests.web.photos import write_photos
from tests.web.places import Place

_PHONE = {**PHONE, "has_touch": True}


def _posted(guarded: Place) -> list[SceneSummary]:
    """Scenes that came by phone."""
    return [scene for scene in guarded.service.list_scenes().scenes if scene.id != guarded.scene_id]


def _link(guarded: Place, visit: Visit, folder: Path) -> str:
    """What the QR code on the page for new scenes says."""
    visit.sign_in(guarded.new_key("editor"))
    expect(visit.page.get_by_text("A phone cannot reach this page at 127.0.0.1.")).to_be_visible()
    visit.check_accessible()
    visit.page.get_by_role("button", name=f"Show a QR code for {guarded.settings.page_address}/").click()
    code = visit.page.get_by_role("img", name="QR code of the link")
    expect(code).to_be_visible()
    visit.check_accessible()
    code.screenshot(path=folder / "code.png")
    picture = cv2.imread(str(folder / "code.png"))
    enlarged = cv2.resize(picture, None, fx=3, fy=3, interpolation=cv2.INTER_AREA)
    # OpenCV's other detector misses about one of 150 codes with random keys; this one read them all.
    text, *_ = cv2.QRCodeDetectorAruco().detectAndDecode(enlarged)
    assert text == visit.page.get_by_role("textbox", name="The link").input_value()
    return text


def test_a_phone_posts_one_scene_by_the_code_and_follows_it(guarded: Place, browser: Browser, tmp_path: Path) -> None:
    with visiting(browser, guarded.url, "#/new", color_scheme="dark", device_scale_factor=1) as desk:
        link = _link(guarded, desk, tmp_path)
    url = guarded.settings.page_address  # where a phone finds the page
    assert link.startswith(f"{url}/#/phone?key=fsk_")
    with visiting(browser, url, link.removeprefix(f"{url}/"), **_PHONE) as phone:
        page = phone.page
        expect(page.get_by_role("heading", name="New scene")).to_be_visible()
        assert page.url == f"{url}/#/phone"  # the key is in no history
        expect(page.get_by_role("link", name="Scenes")).to_have_count(0)
        camera = page.get_by_label("Take photos")
        expect(camera).to_have_attribute("capture", "environment")
        assert phone.fits()
        phone.check_accessible()
        camera.set_input_files(write_photos(tmp_path, 3))
        page.get_by_label("Name", exact=True).fill("by phone")
        page.get_by_role("button", name="Upload").click()
        expect(page.get_by_role("heading", name="Your photos have arrived")).to_be_visible()
        expect(page.get_by_text("Waiting", exact=True)).to_be_visible()
        phone.check_accessible()
        page.reload()
        expect(page.get_by_role("heading", name="Your photos have arrived")).to_be_visible()
        key = link.partition("key=")[2]
        assert not [url for url in phone.requests if key in url]
        phone.expected.append("401")
        page.goto(f"{url}/#/")  # the link opens nothing else
        expect(page.get_by_text("This server needs an access key.")).to_be_visible()
    assert [scene.name for scene in _posted(guarded)] == ["by phone"]
    with visiting(browser, url, link.removeprefix(f"{url}/"), **_PHONE) as second:
        expect(second.page.get_by_role("heading", name="Your photos have arrived")).to_be_visible()
        assert len(_posted(guarded)) == 1


def test_of_two_phones_with_one_link_the_later_is_told(guarded: Place, browser: Browser, tmp_path: Path) -> None:
    new_key = guarded.service.keys.create_for_upload(UploadKeyIn())
    address = f"#/phone?key={new_key.secret}"
    with visiting(browser, guarded.url, address, **_PHONE) as first, visiting(browser, guarded.url, address) as second:
        for number, visit in enumerate((first, second)):
            (tmp_path / str(number)).mkdir()
            files = write_photos(tmp_path / str(number), 3, seed=10 * number)
            visit.page.get_by_label("Choose files").set_input_files(files)
        first.page.get_by_role("button", name="Upload").click()
        expect(first.page.get_by_role("heading", name="Your photos have arrived")).to_be_visible()
        second.expected.append("409")
        second.page.get_by_role("button", name="Upload").click()
        expect(second.page.get_by_role("alert")).to_contain_text("one upload")
        second.check_accessible()
    assert len(_posted(guarded)) == 1


def test_a_link_that_has_expired_says_so(guarded: Place, browser: Browser) -> None:
    new_key = guarded.service.keys.create_for_upload(UploadKeyIn(lifetime_s=1e-3))
    for address in (f"#/phone?key={new_key.secret}", "#/phone?key=fsk_wrong", "#/phone", "#/phone?key=<b>x</b>"):
        with visiting(browser, guarded.url, address, **_PHONE) as visit:
            visit.expected.append("401")
            expect(visit.page.get_by_role("heading", name=re.compile("not valid|not found"))).to_be_visible()
            visit.check_accessible()


def test_a_page_that_only_this_machine_reaches_offers_no_link(place: Place, browser: Browser) -> None:
    with visiting(browser, place.url, "#/new") as visit:
        expect(visit.page.get_by_text("A phone cannot reach this page at 127.0.0.1.")).to_be_visible()
        expect(visit.page.get_by_text("FASTSPLAT_HOST")).to_be_visible()
        expect(visit.page.get_by_role("button", name=re.compile("QR code"))).to_have_count(0)
