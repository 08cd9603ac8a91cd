"""What is typed before the page has come to rest stays."""

from __future__ import annotations

from playwright.sync_api import Browser, expect

from tests.web.browser import visiting
from tests.web.places import Place

_CLICK_AND_TYPE = """(button, text) => new Promise((resolve) => {
  const drawn = new MutationObserver(() => {  // called in the turn in which something is drawn, before it is painted
    const input = document.querySelector(".object-card input");
    if (!input) return;
    drawn.disconnect();
    Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, "value").set.call(input, text);
    input.dispatchEvent(new Event("input", { bubbles: true }));
    input.focus();
    const frame = (next) => requestAnimationFrame(() => setTimeout(next));  // when effects of that drawing have run
    frame(() => frame(() => frame(resolve)));
  });
  drawn.observe(document.body, { childList: true, subtree: true });
  button.click();
})"""
"""Clicks, types into the card's field in the very turn in which it is drawn, and waits until its effects have run."""


def test_a_name_typed_in_the_turn_in_which_the_card_is_drawn_stays(
    place: Place, browser: Browser, scene_id: str
) -> None:
    with visiting(browser, place.url, f"#/scenes/{scene_id}") as visit:
        page = visit.page
        visit.scene_shown()
        objects = visit.tab("Objects")
        objects.get_by_role("button", name="ball").evaluate(_CLICK_AND_TYPE, "violin")
        expect(page.locator(".object-card").get_by_label("Name", exact=True)).to_have_value("violin")
        page.keyboard.press("Enter")
        expect(page.locator(".object-card").get_by_role("heading", name="violin")).to_be_visible()
    assert "violin" in [obj.name for obj in place.service.answers.list_objects(scene_id).objects]
