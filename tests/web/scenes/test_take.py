"""What a person takes away from a scene, and a link that shows one scene alone."""

from __future__ import annotations

import io
import re
from pathlib import Path

import numpy as np
from PIL import Image
from playwright.sync_api import Browser, expect

from fastsplat_contract.messages.exports import ExportRequest
from fastsplat_contract.photos.pictures import PictureRequest
from tests.web.browser import PHONE, Visit, visiting
from tests.web.glow import view_camera
from tests.web.objects.test_ask import _VIEW
from tests.web.places import Place


def _saved(visit: Visit, button: str) -> tuple[str, bytes]:
    """The name and the bytes of what a button of the menu saves."""
    with visit.page.expect_download() as download:
        visit.page.get_by_role("button", name=button, exact=True).click()
    return download.value.suggested_filename, Path(download.value.path()).read_bytes()


def test_scene_object_masks_and_picture_are_the_servers(place: Place, browser: Browser) -> None:
    scene_id = place.new_scene("../a <b>table</b>")
    file = place.service.exports.file
    with visiting(browser, place.url, f"#/scenes/{scene_id}?q=mug&view={_VIEW}") as visit:
        visit.shows("answer")
        visit.tab("Photos")
        expect(visit.page.get_by_text("31.5 dB PSNR · twice the training would add about 0.3 dB")).to_be_visible()
        visit.tab("Share")
        for button, format, ending in (
            ("PLY, exact", "ply", "ply"), ("SPZ, compressed", "spz", "spz"), ("SPZ, version 4", "spz4", "v4.spz"),
            ("SOG, smallest", "sog", "sog"), ("For Foxglove, MCAP", "mcap", "mcap"), ("One HTML file", "html", "html"),
        ):  # fmt: skip
            assert _saved(visit, button) == (f"a _b_table_b.{ending}", file(ExportRequest(scene_id, format)))
        for format, label in (("spz", "SPZ, compressed"), ("html", "One HTML file")):
            row = visit.page.get_by_role("listitem").filter(has_text=label)
            expect(row).to_contain_text("about")
            ((number, unit),) = re.findall(r"about ([\d.]+) (\w+)", row.inner_text())
            size = float(number) * {"B": 1, "kB": 1e3, "MB": 1e6}[unit]
            assert abs(size / len(file(ExportRequest(scene_id, format))) - 1) < 0.1
        assert _saved(visit, "Its Gaussians as PLY") == ("mug.ply", file(ExportRequest(scene_id, object_ids=(1,))))

        camera = view_camera(np.array([float(number) for number in _VIEW.split("_")]), 1280, 720)
        for button, request in (
            ("Picture as PNG", PictureRequest(scene_id, "rgb", camera=camera)),
            ("Mask in this view as PNG", PictureRequest(scene_id, "mask", "mug", camera)),
        ):
            name, content = _saved(visit, button)
            truth = np.asarray(Image.open(io.BytesIO(place.service.answers.picture(request)))).astype(int)
            picture = np.asarray(Image.open(io.BytesIO(content))).astype(int)
            assert name.endswith(".png") and picture.shape == truth.shape and np.abs(picture - truth).mean() < 0.5
        _, content = _saved(visit, "nerfstudio transforms.json")
        assert content == file(ExportRequest(scene_id, "transforms"))

        visit.tab("Objects").get_by_role("button", name="ball", exact=True).click()
        visit.tab("Share")
        (ball,) = [obj for obj in place.service.answers.list_objects(scene_id).objects if obj.name == "ball"]
        of_ball = ExportRequest(scene_id, "ply", object_ids=(ball.id,))
        assert _saved(visit, "Only ball as PLY") == ("ball.ply", file(of_ball))
        visit.check_accessible()


def test_where_no_link_can_be_made_the_page_says_so_and_offers_a_file(place: Place, browser: Browser) -> None:
    with visiting(browser, place.url, f"#/scenes/{place.scene_id}", **PHONE) as visit:
        visit.shows("plain")
        visit.tab("Share")
        expect(visit.page.get_by_text("This server asks nobody for a key, so a link")).to_be_visible()
        expect(visit.page.get_by_role("button", name="Make a link")).to_have_count(0)
        name, content = _saved(visit, "Save as one HTML file")
        assert name == "a table.html" and content == place.service.exports.file(ExportRequest(place.scene_id, "html"))
        assert visit.fits()
        visit.check_accessible()


def test_a_link_shows_one_scene_until_it_is_revoked(guarded: Place, browser: Browser) -> None:
    scene_id = guarded.new_scene("for Ada")
    other_id = guarded.new_scene("for nobody else")
    with visiting(browser, guarded.url, f"#/scenes/{scene_id}") as visit:
        visit.sign_in(guarded.new_key("admin"))
        visit.shows("plain")
        visit.tab("Share")
        visit.page.get_by_label("For whom").fill("Ada <b>")
        visit.page.get_by_role("button", name="Make a link").click()
        link = visit.page.get_by_label("The link; it is shown this once").input_value()
        expect(visit.page.get_by_role("button", name="Revoke the link for Ada <b>")).to_be_visible()
        visit.check_accessible()
        (key,) = guarded.service.keys.list("admin", scene_id=scene_id).keys
        assert (key.name, key.role, key.state) == ("Ada <b>", "reader", "VALID")
        assert link.startswith(f"{guarded.url}/#/scenes/{scene_id}?share=fsk_{key.id}_")

        address = link.removeprefix(f"{guarded.url}/")
        with visiting(browser, guarded.url, address) as visitor:
            visitor.shows("plain")
            expect(visitor.page.get_by_role("heading", level=1)).to_have_text("for Ada")
            for absent in ("New scene", "Scenes"):
                expect(visitor.page.get_by_role("link", name=absent)).to_have_count(0)
            visitor.page.get_by_role("searchbox").fill("ball")
            expect(visitor.page.locator(".verdict.here")).to_be_visible()
            expect(visitor.page).to_have_url(re.compile(r"q=ball.*share=fsk_"))
            visitor.tab("Objects").get_by_role("button", name="mug", exact=True).click()
            expect(visitor.page.get_by_role("button", name="Look at it")).to_be_visible()
            for absent in ("Save the name", "Discard", "Delete scene", "Name the next one", "Undo", "Make a link"):
                expect(visitor.page.get_by_role("button", name=absent)).to_have_count(0)
            visitor.tab("Share")
            for absent in ("Delete scene", "Make a link"):
                expect(visitor.page.get_by_role("button", name=absent)).to_have_count(0)
            visitor.check_accessible()
            assert visitor.page.evaluate("localStorage.getItem('fastsplat-key')") is None
            assert not [url for url in visitor.requests if "fsk_" in url]

            visitor.page.reload()
            expect(visitor.page.locator(".verdict.here")).to_be_visible()
            visitor.expected += ["404", "401"]
            visitor.page.evaluate(f"location.hash = location.hash.replace('{scene_id}', '{other_id}')")
            expect(visitor.page.get_by_role("alert")).to_contain_text("No scene")

            visit.page.get_by_role("button", name="Revoke the link for Ada <b>").click()
            expect(visit.page.get_by_text("revoked")).to_be_visible()
            visitor.page.goto(f"{guarded.url}/{address}")
            visitor.page.reload()
            expect(visitor.page.get_by_text("This link has ended")).to_be_visible(timeout=30_000)
            visitor.check_accessible()
