"""The scene in a notebook's cell: the viewer of single files in a frame that reaches nothing around it."""

from __future__ import annotations

from pathlib import Path

from playwright.sync_api import Browser, expect

from fastsplat.service.library.local_scene import LocalScene
from tests.web.browser import visiting
from tests.web.places import Place


def test_a_cell_shows_the_scene_and_answers(place: Place, webgl_browser: Browser, tmp_path: Path) -> None:
    viewer = LocalScene(place.service, place.scene_id).viewer(height=480)
    notebook = tmp_path / "notebook.html"
    notebook.write_text(f"<!doctype html><meta charset=utf-8><body>{viewer._repr_html_()}</body>")
    viewer.save(tmp_path / "scene.html")
    assert (tmp_path / "scene.html").read_bytes() == viewer.page
    window = {"viewport": {"width": 1000, "height": 600}, "offline": True}
    with visiting(webgl_browser, tmp_path.as_uri(), notebook.name, **window) as visit:
        frame = visit.page.frame_locator("iframe")
        expect(frame.locator("canvas[data-shown=plain]")).to_be_visible()
        frame.get_by_role("searchbox").fill("mug")
        frame.get_by_role("button", name="Ask", exact=True).click()
        expect(frame.locator(".verdict.here")).to_be_visible()
        expect(frame.locator("canvas[data-shown=answer]")).to_be_visible()
