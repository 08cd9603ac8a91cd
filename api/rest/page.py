"""Web page: a client of the public REST API, built by `make page` from `api/web/`."""

from __future__ import annotations

from pathlib import Path

from fastapi import FastAPI, Request
from starlette.responses import Response

from fastsplat.api.rest.static_files import ReleaseFiles
from fastsplat_contract.errors import NotFoundError

BUILT_PAGE = Path(__file__).resolve().parent.parent / "web" / "dist"
"""Folder of the built page, in a checkout and in a wheel."""

PAGE_POLICY = (
    # Nothing external or inline, no eval. Blobs: the 3D engine's workers, and pictures fetched with the key.
    "default-src 'none'; script-src 'self'; worker-src 'self' blob:; connect-src 'self'; img-src 'self' blob: data:; "
    "style-src 'self'; font-src 'self'; form-action 'none'; base-uri 'none'; frame-ancestors 'none'"
)


def add_page(app: FastAPI, folder: Path = BUILT_PAGE) -> None:
    """Adds the page (or how to build it) at `/` and its files at `/web`."""
    files = ReleaseFiles(folder, immutable="assets")

    @app.get("/", include_in_schema=False)
    async def page(request: Request) -> Response:
        if not (folder / "index.html").is_file():
            raise NotFoundError(
                "the web page is not built in this installation",
                hint="Install Node.js 18.19 or later with npm and run: make page. The API works without it.",
            )
        response = await files.get_response("index.html", request.scope)
        response.headers["Content-Security-Policy"] = PAGE_POLICY
        return response

    app.mount("/web", files, name="web")
