"""The scene in a notebook's cell: the viewer of single files in a frame that reaches nothing around it."""

from __future__ import annotations

from pathlib import Path

from playwright.sync_api import Browser, expect

from fastsplat.service.library.local_scene import LocalScene
from tests.web.places import Place


def test_a_cell_shows_the_scene_and_answers(place: Place, webgl_browser: Browser, tmp_path: Path) -> None:
    viewer = LocalScene(place.service, place.scene_id).viewer(height=480)
    notebook = tmp_path / "notebook.html"
    notebook.write_text(f"<!doctype html><meta charset=utf-8><body>{viewer._repr_html_()}</body>")
    viewer.save(tmp_path / "scene.html")
    assert (tmp_path / "scene.html").read_bytes() == viewer.page
    context = webgl_browser.new_context(viewport={"width": 1000, "height": 600}, reduced_motion="reduce")
    try:
        context.set_offline(True)
        page = context.new_page()
        trouble: list[str] = []
        page.on("console", lambda message: trouble.append(message.text) if message.type == "error" else None)
        page.on("pageerror", lambda error: trouble.append(str(error)))
        page.goto(notebook.as_uri())
        frame = page.frame_locator("iframe")
        expect(frame.locator("canvas[data-shown=plain]")).to_be_visible()
        frame.get_by_role("searchbox").fill("mug")
        frame.get_by_role("button", name="Ask", exact=True).click()
        expect(frame.locator(".verdict.here")).to_be_visible()
        expect(frame.locator("canvas[data-shown=answer]")).to_be_visible()
        assert trouble == []
    finally:
        context.close()
