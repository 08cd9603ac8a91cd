"""The page's files over HTTP: what they may load, how long a browser keeps them, what a server without them says."""

from __future__ import annotations

import asyncio
from pathlib import Path

import httpx
import pytest
from fastapi import FastAPI

from fastsplat.api.rest import problem_answers
from fastsplat.api.rest.middleware import OuterLayer
from fastsplat.api.rest.page import BUILT_PAGE, add_page


class _Server:
    """An application of the page alone."""

    def __init__(self, folder: Path) -> None:
        self._app = FastAPI()
        self._app.add_middleware(OuterLayer)
        problem_answers.install(self._app)
        add_page(self._app, folder)

    def get(self, path: str) -> httpx.Response:
        async def ask() -> httpx.Response:
            transport = httpx.ASGITransport(self._app)
            async with httpx.AsyncClient(transport=transport, base_url="http://page") as client:
                return await client.get(path)

        return asyncio.run(ask())


@pytest.fixture
def client(tmp_path: Path) -> _Server:
    """A page of two files."""
    (tmp_path / "index.html").write_text("<!doctype html>")
    (tmp_path / "assets").mkdir()
    (tmp_path / "assets/index-abc123.js").write_text("export {};")
    return _Server(tmp_path)


def test_the_page_may_load_nothing_inline_nothing_evaluated_and_nothing_from_elsewhere(client: _Server) -> None:
    policy = client.get("/").headers["content-security-policy"]
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
    assert rules["default-src"] == rules["base-uri"] == rules["frame-ancestors"] == "'none'"
    assert rules["script-src"] == rules["connect-src"] == rules["style-src"] == "'self'"
    sources = {source for rule in rules.values() for source in rule.split()}
    assert sources == {"'none'", "'self'", "blob:", "data:"}


def test_a_browser_keeps_files_with_a_hash_in_their_name_and_asks_about_the_page(client: _Server) -> None:
    assert client.get("/").headers["cache-control"] == "no-cache"
    assert "immutable" in client.get("/web/assets/index-abc123.js").headers["cache-control"]
    assert client.get("/web/index.html").headers["cache-control"] == "no-cache"
    assert client.get("/web/assets/../../conftest.py").status_code == 404


def test_a_server_without_a_built_page_says_how_to_build_it(tmp_path: Path) -> None:
    response = _Server(tmp_path / "dist").get("/")
    assert response.status_code == 404
    assert "not built" in response.json()["detail"] and "make page" in response.json()["hint"]
    assert _Server(tmp_path / "dist").get("/web/index.html").status_code == 404


def test_the_built_page_is_looked_for_beside_its_sources() -> None:
    assert (BUILT_PAGE.parent / "package.json").is_file()
