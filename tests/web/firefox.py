"""Debian's Firefox over WebDriver BiDi (https://www.w3.org/TR/webdriver-bidi/), which it speaks without a driver."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from threading import Thread
from typing import Any

import pytest
from websockets.sync.client import ClientConnection, connect

_PATIENCE_S = 60
_WATCHED = ("log.entryAdded", "network.responseCompleted")
_PREFERENCES = {
    "ui.prefersReducedMotion": 1,
    "app.update.enabled": False,
    "network.captive-portal-service.enabled": False,
}
_REPORTS = """() => {
  window.cspReports = [];
  document.addEventListener("securitypolicyviolation", (event) =>
    window.cspReports.push(`${event.violatedDirective} ${event.blockedURI}`));
}"""
_UNTIL = """(async () => {
  for (const end = performance.now() + %d; performance.now() < end; ) {
    if (%s) return true;
    await new Promise((done) => setTimeout(done, 50));
  }
  return false;
})()"""


@dataclass
class Firefox:
    """One tab, and what went wrong in it."""

    _socket: ClientConnection
    _tab: str = ""
    _sent: int = 0
    troubles: list[str] = field(default_factory=list)
    addresses: list[str] = field(default_factory=list)

    def begin(self) -> None:
        """Take the tab that is open, and watch it."""
        self._call("session.new", capabilities={})
        self._call("session.subscribe", events=list(_WATCHED))
        self._call("script.addPreloadScript", functionDeclaration=_REPORTS)
        self._tab = self._call("browsingContext.getTree")["contexts"][0]["context"]

    def go(self, url: str) -> None:
        self._call("browsingContext.navigate", context=self._tab, url=url, wait="complete")

    def evaluate(self, expression: str) -> Any:
        """What an expression gives in the page: a text, a number, true, false or null."""
        target = {"context": self._tab}
        answer = self._call("script.evaluate", expression=expression, target=target, awaitPromise=True)
        assert answer["type"] == "success", answer
        return answer["result"].get("value")

    def until(self, condition: str) -> None:
        """Return once an expression is true in the page."""
        held = self.evaluate(_UNTIL % (1000 * _PATIENCE_S, condition))
        assert held, (condition, self.evaluate("document.body.innerText"), self.troubles)

    def click(self, selector: str) -> None:
        """Click in the middle of the first element of a CSS selector."""
        locator = {"type": "css", "value": selector}
        nodes = self._call("browsingContext.locateNodes", context=self._tab, locator=locator)["nodes"]
        assert nodes, selector
        origin = {"type": "element", "element": {"sharedId": nodes[0]["sharedId"]}}
        move: dict[str, Any] = {"type": "pointerMove", "x": 0, "y": 0, "origin": origin}
        self._act("pointer", [move, {"type": "pointerDown", "button": 0}, {"type": "pointerUp", "button": 0}])

    def type(self, text: str) -> None:
        """Press and release a key for each letter."""
        self._act("key", [{"type": kind, "value": letter} for letter in text for kind in ("keyDown", "keyUp")])

    def _act(self, kind: str, actions: list[dict[str, Any]]) -> None:
        source = {"type": kind, "id": kind, "actions": actions}
        self._call("input.performActions", context=self._tab, actions=[source])

    def _call(self, method: str, **parameters: Any) -> dict[str, Any]:
        self._sent += 1
        self._socket.send(json.dumps({"id": self._sent, "method": method, "params": parameters}))
        while True:
            message = json.loads(self._socket.recv(timeout=2 * _PATIENCE_S))
            if message["type"] == "event":
                self._note(message["method"], message["params"])
            elif message.get("id") == self._sent:
                assert message["type"] == "success", message
                result: dict[str, Any] = message["result"]
                return result

    def _note(self, method: str, event: dict[str, Any]) -> None:
        if method == "log.entryAdded":
            if event["level"] in ("error", "warn"):
                self.troubles.append(event["text"])
            return
        url, status = event["response"]["url"], event["response"]["status"]
        self.addresses.append(url)
        if status >= 400:
            self.troubles.append(f"{status} {url}")


@contextmanager
def firefox(profile: Path) -> Iterator[Firefox]:
    """The browser with a new profile, on a screen in memory for WebGL in software; a skip where there is none."""
    missing = [name for name in ("firefox-esr", "Xvfb") if shutil.which(name) is None]
    if missing:
        pytest.skip(f"no {' and no '.join(missing)} in this machine: apt-get install firefox-esr xvfb")
    lines = [f"user_pref({json.dumps(name)}, {json.dumps(value)});" for name, value in _PREFERENCES.items()]
    (profile / "user.js").write_text("\n".join(lines))
    command = ["firefox-esr", "--no-remote", "--profile", str(profile), "--remote-debugging-port", "0", "about:blank"]
    with _started("Xvfb", "-displayfd", "2", "-nolisten", "tcp", "-screen", "0", "1000x700x24") as screen:
        display = _said(screen, r"^(\d+)$")
        with _started(*command, environment={"DISPLAY": f":{display}", "MOZ_ENABLE_WAYLAND": "0"}) as process:
            address = _said(process, r"BiDi listening on (ws://\S+)")
            with connect(f"{address}/session", max_size=None, ping_interval=None) as socket:
                started = Firefox(socket)
                started.begin()
                yield started


@contextmanager
def _started(*command: str, environment: Mapping[str, str] | None = None) -> Iterator[subprocess.Popen[str]]:
    environ = {**os.environ, **(environment or {})}
    with subprocess.Popen(
        command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True, env=environ
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def _said(process: subprocess.Popen[str], pattern: str) -> str:
    """What a program tells on its error output."""
    lines = []
    for line in process.stderr:
        lines.append(line)
        if found := re.search(pattern, line):
            Thread(target=process.stderr.read, daemon=True).start()  # a full pipe would stop the program
            return found[1]
    raise AssertionError("".join(lines))
