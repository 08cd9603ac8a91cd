"""The FastAPI application."""

from __future__ import annotations

import gzip
import json
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, get_args

import fastapi_offline
from fastapi import APIRouter, FastAPI, Request
from fastapi.openapi.docs import get_swagger_ui_html
from starlette.middleware.cors import CORSMiddleware
from starlette.responses import Response

from fastsplat.api.access.caller import in_callers_project
from fastsplat.api.access.gate import Gate, build_gate
from fastsplat.api.access.policy import rule_of
from fastsplat.api.health import Readiness
from fastsplat.api.rest import problem_answers
from fastsplat.api.rest.access import AccessLayer
from fastsplat.api.rest.examples import add_examples
from fastsplat.api.rest.middleware import OuterLayer
from fastsplat.api.rest.page import add_page
from fastsplat.api.rest.responses import json_response
from fastsplat.api.rest.routes.assistant import Assistant
from fastsplat.api.rest.routes.file_routes import export_routes, photo_routes
from fastsplat.api.rest.routes.health import health_routes
from fastsplat.api.rest.routes.localize_routes import localize_routes
from fastsplat.api.rest.routes.query_routes import query_routes
from fastsplat.api.rest.routes.scene_routes import operation_routes, scene_routes, server_routes
from fastsplat.api.rest.routes.table_routes import table_routes
from fastsplat.api.rest.routes.tus import tus_routes
from fastsplat.api.rest.standard_http import etag_of, not_modified, reads_gzip
from fastsplat.api.rest.static_files import ReleaseFiles
from fastsplat.api.threads import Threads
from fastsplat.service.application.service import SceneService
from fastsplat.service.settings import Settings
from fastsplat_contract.call import Tag
from fastsplat_contract.calls import DEPRECATED
from fastsplat_contract.codec.json_codec import json_schema_of
from fastsplat_contract.server.problems import Problem
from fastsplat_contract.server.server_info import ServerInfo

_SWAGGER = (
    Path(fastapi_offline.__file__).parent / "static"
)  # FastAPI's own page needs a CDN, which an isolated network cannot reach
_TAGS = (
    {"name": "server", "description": "What this server can do."},
    {"name": "scenes", "description": "Captures come in, scenes are looked at, edited and deleted."},
    {"name": "uploads", "description": "Large files in pieces, by tus 1.0.0."},
    {"name": "operations", "description": "The jobs that train scenes: look, wait, watch, cancel, end early, retry."},
    {"name": "queries", "description": "Questions in plain words; pictures and files of finished scenes."},
    {"name": "keys", "description": "Who may call about the project: for its admins, and operators."},
    {"name": "known names", "description": "What people named in the project's scenes, to be suggested in others."},
    {"name": "health", "description": "For load balancers; needs no key."},
)
_DOCS_POLICY = (  # Swagger UI needs inline styles and an inline script
    "default-src 'self'; script-src 'self' 'unsafe-inline'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; "
    "object-src 'none'; base-uri 'none'; frame-ancestors 'none'"
)
_DESCRIPTION = """Photos of a place in, a 3D scene out that can be asked, in plain words, where objects are.

**Frames**: OpenCV camera axes (x right, y down, z forward), poses are world_from_camera, quaternions x y z w.
**Units**: scene units (meters when the scene's `scale` is METRIC), seconds, pixels with centers at +0.5.
**Keys**: `Authorization: Bearer KEY` or `X-Api-Key: KEY`; health alone needs none. A key belongs to a project, and what
is another project's does not exist for it; an operator's may name another project as `X-Fastsplat-Project`.
**Errors**: RFC 9457 problems; `reason` is stable. The same content goes over gRPC as google.rpc.Status."""


class _App(FastAPI):
    def openapi(self) -> dict[str, Any]:
        if self.openapi_schema is None:
            schema = super().openapi()
            schema["components"]["schemas"]["Problem"] = json_schema_of(Problem)
            schema["components"]["securitySchemes"] = {"key": {"type": "http", "scheme": "bearer"}}
            for path, operations in schema["paths"].items():
                for method, operation in operations.items():
                    route = f"{method.upper()} {path}"
                    operation["security"] = [] if rule_of(route).role is None else [{"key": []}]
                    if route in DEPRECATED:
                        operation["deprecated"] = True
                        operation["description"] += f" Deprecated: use {DEPRECATED[route]}."
            add_examples(schema)
        return super().openapi()


def create_app(
    service: SceneService,
    settings: Settings,
    threads: Threads | None = None,
    gate: Gate | None = None,
    readiness: Readiness | None = None,
    grpc_port: int | None = None,
) -> FastAPI:
    """Builds the REST application, with the web page at `/`.

    Args:
        threads: pools shared with gRPC; the caller closes them.
        gate: access control shared with gRPC; if None and keys are on, all calls that need a key are refused.
        readiness: the state of `/readyz`; if None, never ready.
        grpc_port: the port of gRPC, told to clients.
    """
    service = in_callers_project(service)
    threads = threads or Threads()
    assistant = Assistant()
    app = _App(
        title="FAST-Splat scene service",
        version="v1",
        description=_DESCRIPTION,
        docs_url=None,
        openapi_url=None,
        generate_unique_id_function=lambda route: route.name,
        redoc_url=None,
        servers=[{"url": settings.root_path or "/"}],
        openapi_tags=[dict(tag) for tag in _TAGS],
        license_info={"name": "Apache-2.0", "identifier": "Apache-2.0"},
        lifespan=assistant.lifespan,
        redirect_slashes=False,  # a redirect would reveal paths to callers without a key
    )
    app.add_middleware(AccessLayer, routed=app, gate=gate or build_gate(settings, None))
    app.add_middleware(OuterLayer)
    if settings.cors_origins:  # outermost: a browser's preflight carries no key
        app.add_middleware(
            CORSMiddleware,
            allow_origins=list(settings.cors_origins),
            allow_methods=["*"],
            allow_headers=["*"],
            expose_headers=["*"],
            max_age=600,
        )
    problem_answers.install(app)
    address = settings.grpc_address or (None if grpc_port is None else f":{grpc_port}")
    info = ServerInfo(version("fastsplat"), address)
    max_upload_bytes, root_path = settings.capture.max_upload_bytes, settings.root_path
    written: tuple[tuple[Tag, APIRouter], ...] = (
        ("server", server_routes(info)),
        ("scenes", scene_routes(service, settings, threads)),
        ("operations", operation_routes(service, threads)),
        ("queries", query_routes(service, threads)),
        ("queries", photo_routes(service, threads)),
        ("queries", localize_routes(service, settings, threads)),
        ("queries", export_routes(service, threads)),
    )
    for tag, router in written:  # before the table's: the path of a job also matches that of waiting for it
        app.include_router(router, tags=[tag])
    for tag in get_args(Tag):
        app.include_router(table_routes(tag, service, threads, root_path), tags=[tag])
    app.include_router(tus_routes(service, threads, max_upload_bytes, root_path), tags=["uploads"])
    app.include_router(health_routes(readiness or Readiness(lambda: None)), tags=["health"])

    @cache
    def description() -> tuple[bytes, bytes]:
        body = json.dumps(app.openapi(), ensure_ascii=False).encode()
        return body, gzip.compress(body, mtime=0)

    @app.get("/openapi.json", include_in_schema=False)
    async def openapi(request: Request) -> Response:
        body, compressed = description()
        headers = {"ETag": etag_of(body), "Cache-Control": "no-cache", "Vary": "Accept-Encoding"}
        if (unchanged := not_modified(request, headers)) is not None:
            return unchanged
        if reads_gzip(request.headers):
            return json_response(compressed, 200, {**headers, "Content-Encoding": "gzip"})
        return json_response(body, 200, headers)

    @app.get("/docs", include_in_schema=False)
    async def docs() -> Response:
        page = get_swagger_ui_html(
            openapi_url="openapi.json",  # relative URLs work behind a proxy under any path
            title=app.title,
            swagger_js_url="docs-files/swagger-ui-bundle.js",
            swagger_css_url="docs-files/swagger-ui.css",
            swagger_favicon_url="web/icon.svg",
        )
        page.headers["Content-Security-Policy"] = _DOCS_POLICY
        return page

    app.router.routes.append(assistant.route())
    app.mount("/docs-files", ReleaseFiles(_SWAGGER), name="docs-files")
    add_page(app)
    return app
