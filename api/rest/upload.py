"""`POST /v1/scenes`: a form that streams into an upload session while it arrives."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterator
from itertools import islice
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError
from starlette.requests import ClientDisconnect, Request

from fastsplat.api.access.caller import caller_project
from fastsplat.api.rest.multipart import Part, read_parts
from fastsplat.api.rest.responses import while_connected
from fastsplat.api.threads import Threads
from fastsplat.api.uploads import check_announced, scene_options
from fastsplat.service.application.service import SceneService
from fastsplat.service.settings import Settings
from fastsplat_contract.errors import FastSplatError, InvalidInputError, LimitExceededError
from fastsplat_contract.json_codec import json_schema_of
from fastsplat_contract.operations import Operation, SceneOptions

_FILE_FIELDS = ("capture", "images", "files")
_MAX_TEXT_BYTES = 2**20
_MAX_TEXT_PARTS = 2_000
_MAX_EPILOGUE_CHUNKS = 64


def _options() -> dict[str, Any]:
    """The fields of `SceneOptions`, as a form has them: absent is left out."""
    fields = {}
    for name, said in json_schema_of(SceneOptions)["properties"].items():
        (one,) = (choice for choice in said.get("anyOf", [said]) if choice.get("type") != "null")
        fields[name] = {**one, "description": said["description"]}
    return fields


BODY_SCHEMA: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "content": {
            "multipart/form-data": {
                "schema": {
                    "type": "object",
                    "properties": {
                        "capture": {
                            "type": "string",
                            "format": "binary",
                            "description": "one zip, tar, video or splat (PLY or SPZ); images alone, a COLMAP model or "
                            "nerfstudio's transforms.json with its images",
                        },
                        "images": {
                            "type": "array",
                            "items": {"type": "string", "format": "binary"},
                            "description": "photos, each with its own file name; folders in the name are kept",
                        },
                        "files": {
                            "type": "array",
                            "items": {"type": "string", "format": "binary"},
                            "description": "the files of a capture's folder under their names in it: photos, masks, "
                            "label maps, transforms.json, labels.json, a COLMAP model, points, a splat",
                        },
                        "uploads": {
                            "type": "array",
                            "items": {"type": "string"},
                            "description": "ids of whole resumable uploads (tus, /v1/uploads), instead of files or "
                            "beside them",
                        },
                        "name": {"type": "string", "description": "for people; need not be unique"},
                        "request_id": {
                            "type": "string",
                            "description": "same id, same request: the first operation is returned again (AIP-155)",
                        },
                        **_options(),
                    },
                }
            }
        },
    }
}
"""What OpenAPI says of the form, which no FastAPI parameter describes because the route reads the stream itself."""


class _Texts(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    name: str = ""
    request_id: str = ""
    labels: list[str] = []
    uploads: list[str] = []
    time_budget_s: float | None = None
    max_gaussians: int | None = None
    preset: str = ""
    priority: int = 0
    up: str = ""


async def receive_scene(request: Request, service: SceneService, settings: Settings, threads: Threads) -> Operation:
    """Take the form's files and queue their job; anything refused leaves nothing behind.

    Raises:
        FastSplatError: what the form, the files or the service's limits have against it.
    """
    stream, body_read = aiter(request.stream()), asyncio.Event()
    project = caller_project()
    content_type = request.headers.get("content-type", "")
    try:
        announced = request.headers.get("content-length", "0")
        check_announced(int(announced) if announced.isdigit() else 0, settings.capture.max_upload_bytes)
        return await while_connected(
            request,
            threads.consume(
                _noting_end(stream, body_read),
                lambda body: _receive(service, settings, project, content_type, body),
                size=len,
            ),
            body_read,
        )
    except FastSplatError:
        if "expect" not in request.headers:
            await _drain(stream)
        raise


async def _noting_end(stream: AsyncIterator[bytes], end: asyncio.Event) -> AsyncIterator[bytes]:
    async for chunk in stream:
        yield chunk
    end.set()


async def _drain(stream: AsyncIterator[bytes]) -> None:
    """Read on for a moment: closing on a sender that is still writing resets the connection, and our answer is lost."""
    total = 0
    try:
        async with asyncio.timeout(2.0):
            while total < 2**25:
                total += len(await anext(stream))
    except (StopAsyncIteration, TimeoutError, ClientDisconnect):
        pass


def _receive(
    service: SceneService, settings: Settings, project: str, content_type: str, body: Iterator[bytes]
) -> Operation:
    texts: dict[str, list[str]] = {}
    text_bytes = 0
    captures = 0
    with service.new_upload() as upload:
        for part in read_parts(content_type, body, settings.capture.max_entries + _MAX_TEXT_PARTS):
            if part.filename is None:
                value = _text(part, _MAX_TEXT_BYTES - text_bytes)
                text_bytes += len(value)
                texts.setdefault(part.field, []).append(value.decode(errors="replace"))
            elif part.field not in _FILE_FIELDS:
                raise InvalidInputError(
                    f"files are not accepted under {part.field[:80]!r}",
                    field=part.field[:80],
                    hint='Send one archive or video as "capture", photos as "images", or a folder as "files".',
                )
            elif part.filename:  # a browser sends an empty name when nothing was chosen
                captures += part.field == "capture"
                if captures > 1:
                    raise InvalidInputError(
                        "more than one capture", field="capture", hint='Send single photos as "images".'
                    )
                upload.write(part.filename, part.chunks)
        _read_to_end(body)
        form = _form(texts)
        for upload_id in form.uploads:
            upload.adopt(*service.resumable.complete(project, upload_id))
        options = scene_options(
            form.labels, form.time_budget_s, form.max_gaussians, form.preset, form.priority, form.up
        )
        return service.create_scene(upload, form.name, form.request_id, options)


def _read_to_end(body: Iterator[bytes]) -> None:
    """Behind the closing boundary there may be a few bytes more, which say nothing (RFC 2046)."""
    if sum(map(len, islice(body, _MAX_EPILOGUE_CHUNKS))) > _MAX_TEXT_BYTES or next(body, None) is not None:
        raise InvalidInputError("the form goes on behind its closing boundary", field="body")


def _text(part: Part, room: int) -> bytes:
    value = b""
    for chunk in part.chunks:
        value += chunk
        if len(value) > room:
            raise LimitExceededError(
                "the form's text fields are too long", field=part.field[:80], limit=f"{_MAX_TEXT_BYTES} bytes together"
            )
    return value


def _form(texts: dict[str, list[str]]) -> _Texts:
    for field, values in texts.items():
        if field not in ("labels", "uploads") and len(values) > 1:
            raise InvalidInputError(f"{field[:80]} is there {len(values)} times", field=field[:80])
    single = {field: values if field in ("labels", "uploads") else values[0] for field, values in texts.items()}
    try:
        return _Texts.model_validate(single)
    except ValidationError as error:
        first = error.errors()[0]
        raise InvalidInputError(first["msg"], field=str(first["loc"][0])[:80]) from None
