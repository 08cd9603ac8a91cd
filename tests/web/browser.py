"""Debian's Chromium, driven as a person drives it, and what must hold of every page that it shows."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest
from playwright.sync_api import Browser, ConsoleMessage, Locator, Page, expect, sync_playwright

_ROOT = Path(__file__).parents[2]
PATIENCE_MS = 60_000
_SOFTWARE_WEBGL = ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox")
_NO_WEBGL = ("--disable-3d-apis", "--disable-gpu", "--no-sandbox")
_WINDOW = {"viewport": {"width": 1000, "height": 700}, "reduced_motion": "reduce", "device_scale_factor": 0.5}
"""A quarter of the pixels, which software draws: the page is laid out in CSS pixels all the same."""
PHONE: dict[str, Any] = {"viewport": {"width": 390, "height": 844}}
TOUCH_PHONE = {**PHONE, "has_touch": True, "is_mobile": True}
_DRAWN = """async (pause) => {
  for (let frame = 0; frame < 3; frame++) await new Promise(requestAnimationFrame);
  const isSeen = ({ top, bottom }) => bottom > 0 && top < innerHeight;
  const pictures = [...document.images].filter((picture) => isSeen(picture.getBoundingClientRect()));
  await Promise.all(pictures.map((picture) => picture.decode().catch(() => undefined)));
  await new Promise((done) => setTimeout(done, pause));
}"""
_NOTED_MS = 400  # later than the page notes in its address where its camera came to rest: 250 ms after its last motion

# The page's policy forbids inline scripts, so that this is not run as one: the browser injects it before any page.
_LISTENER = """
window.cspReports = [];
window.unanswered = 0;
const ask = window.fetch;
window.fetch = (...request) => {
  window.unanswered++;
  return ask(...request).finally(() => window.unanswered--);
};
document.addEventListener("securitypolicyviolation", (event) =>
  window.cspReports.push(`${event.violatedDirective} ${event.blockedURI}`));
"""


@contextmanager
def chromium(*, webgl: bool = True) -> Iterator[Browser]:
    """The browser, or a skip where there is none."""
    path = shutil.which("chromium")
    if path is None:
        pytest.skip("no chromium in this machine: apt-get install chromium")
    expect.set_options(timeout=PATIENCE_MS)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=list(_SOFTWARE_WEBGL if webgl else _NO_WEBGL))
        yield browser
        browser.close()


@contextmanager
def with_webgl(browser: Browser) -> Iterator[Browser]:
    """A second browser like this one, with WebGL."""
    path = shutil.which("chromium")
    second_browser = browser.browser_type.launch(executable_path=path, args=list(_SOFTWARE_WEBGL))
    yield second_browser
    second_browser.close()


@dataclass
class Visit:
    """One page under watch."""

    page: Page
    expected: list[str] = field(default_factory=list)
    _errors: list[str] = field(default_factory=list)
    _requests: list[str] = field(default_factory=list)

    def watch(self) -> None:
        """Note what the page does from now on."""
        self.page.add_init_script(_LISTENER)
        self.page.set_default_timeout(PATIENCE_MS)
        self.page.on("console", self._note)
        self.page.on("pageerror", lambda error: self._errors.append(str(error)))
        self.page.on("request", lambda request: self._requests.append(request.url))

    def _note(self, line: ConsoleMessage) -> None:
        if line.type in ("error", "warning"):
            self._errors.append(f"{line.text} {line.location['url']}")

    def sign_in(self, key: str) -> None:
        """Enter an access key, which the page asks for once a request was refused."""
        self.expected.append("401")
        self.page.get_by_label("Access key").fill(key)
        self.page.get_by_role("button", name="Sign in").click()

    @property
    def requests(self) -> list[str]:
        """Addresses that the page asked for."""
        return list(self._requests)

    def scene_shown(self) -> Locator:
        """The 3D view, once it shows the scene (drawn by the browser if it can) and the list of objects is there."""
        canvas = self.page.locator("canvas[role=application]")
        expect(canvas).to_have_attribute("data-shown", re.compile(r"(plain|answer)$"))
        self.page.keyboard.press("Shift")  # a first gesture, which moves nothing
        expect(canvas).to_have_attribute("data-drawn", re.compile("webgl|server"))
        expect(self.page.get_by_role("tab", name=re.compile(r"^Objects \d"))).to_be_visible()
        return canvas

    def shows(self, what: str) -> None:
        """Return once the 3D view shows the "plain" scene, or an "answer"."""
        expect(self.page.locator("canvas")).to_have_attribute("data-shown", re.compile(f"{what}$"))

    def tab(self, name: str) -> Locator:
        """What is behind a tab of the scene's panel, which is opened."""
        self.page.get_by_role("tab", name=name).click()
        return self.page.get_by_role("tabpanel", name=name)

    def name_object(self, name: str) -> None:
        """Give the object that is selected a name, in its card."""
        card = self.page.locator(".object-card")
        card.get_by_label("Name", exact=True).fill(name)
        card.get_by_role("button", name="Save the name").click()

    def at_rest(self) -> None:
        """Return when what was asked of the camera is done and noted in the address."""
        self.page.evaluate(_DRAWN, _NOTED_MS)

    def reload_with_clock(self) -> None:
        """Load the page anew, with a clock that `requests_within` can put forward."""
        self.page.clock.install()
        self.page.reload()

    def requests_within(self, seconds: float) -> list[str]:
        """What the page asks for, of its own accord, while its clock is put forward by so much."""
        before = len(self._requests)
        self.page.clock.run_for(round(1000 * seconds))
        with self.page.expect_request("**/livez"):  # after all that were made before it
            self.page.evaluate("void fetch('livez')")
        return [url for url in self._requests[before:] if not url.endswith("/livez")]

    def check(self, origin: str) -> None:
        """Nothing in the console but what the test expects, no report of the security policy, no other host."""
        unexpected = [text for text in self._errors if not any(part in text for part in self.expected)]
        assert not unexpected, unexpected
        assert self.page.evaluate("window.cspReports") == []
        for url in self._requests:
            assert url.startswith((f"{origin}/", "blob:", "data:")), url

    def check_accessible(self) -> None:
        """axe-core finds nothing against WCAG 2.2 A and AA, nor against its own best practices."""
        self.page.evaluate((_ROOT / "api/web/node_modules/axe-core/axe.min.js").read_text())
        result: dict[str, Any] = self.page.evaluate("axe.run({ resultTypes: ['violations'] })")
        problems = [
            f"{violation['id']}: {node['html']} {node['failureSummary']}"
            for violation in result["violations"]
            for node in violation["nodes"]
        ]
        assert not problems, "\n".join(problems)

    def fits(self) -> bool:
        """Whether nothing is wider than the window."""
        return bool(self.page.evaluate("document.documentElement.scrollWidth <= window.innerWidth"))


def drawn(page: Page, box: Any) -> bytes:
    """A PNG of a rectangle of the page, once three pictures in a row are alike: software WebGL draws late."""
    alike, picture = 0, b""
    for _ in range(200):
        page.evaluate(_DRAWN, 50)
        before, picture = picture, page.screenshot(clip=box)
        alike = alike + 1 if picture == before and not page.evaluate("window.unanswered") else 0
        if alike == 2:
            return picture
    raise AssertionError("the page does not come to rest")


def drawn_canvas(page: Page) -> bytes:
    """The same of the 3D picture, with what lies over it."""
    return drawn(page, page.locator("canvas").bounding_box())


@contextmanager
def visiting(browser: Browser, url: str, address: str = "", **options: Any) -> Iterator[Visit]:
    """A visit to a page with a browser profile of its own; what must always hold is checked in the end."""
    context = browser.new_context(**{**_WINDOW, **options})
    try:
        visit = Visit(context.new_page())
        visit.watch()
        visit.page.goto(f"{url}/{address}")
        yield visit
        parts = urlsplit(url)
        visit.check(f"{parts.scheme}://{parts.netloc}")
    finally:
        context.close()
