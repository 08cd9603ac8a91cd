"""`POST /v1/scenes`: streams a form into an upload session; also receives other forms."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Sequence
from typing import Any, TypeVar

from pydantic import ConfigDict, ValidationError, create_model
from starlette.requests import Request

from fastsplat.api.access.caller import caller_project
from fastsplat.api.receiving import Sink
from fastsplat.api.rest.responses import while_connected
from fastsplat.api.rest.routes.multipart import FormParser
from fastsplat.api.threads import Threads
from fastsplat.api.uploads import OPTIONS, check_announced, scene_options
from fastsplat.service.application.service import SceneService
from fastsplat.service.application.uploading.uploads import UploadFile
from fastsplat.service.settings import Settings
from fastsplat_contract.codec.json_codec import json_schema_of
from fastsplat_contract.codec.members import Member, members
from fastsplat_contract.errors import FastSplatError, InvalidInputError, LimitExceededError
from fastsplat_contract.jobs.operations import Operation, SceneOptions

_FILE_FIELDS = ("capture", "images", "files")
_MAX_TEXT_BYTES = 2**20
_MAX_TEXT_PARTS = 2_000
_R = TypeVar("_R")


def _options() -> dict[str, Any]:
    """Builds the form schema of `SceneOptions`, without null as a choice."""
    fields = {}
    for name, said in json_schema_of(SceneOptions)["properties"].items():
        (schema,) = (choice for choice in said.get("anyOf", [said]) if choice.get("type") != "null")
        fields[name] = {**schema, "description": said["description"]}
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
                            "description": "one zip, tar, video or splat (PLY, SPZ, SOG); images alone, a COLMAP model "
                            "or nerfstudio's transforms.json with its images",
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
"""OpenAPI schema of the form, because the route reads the stream itself."""


def _text(member: Member) -> Any:
    """Returns an option's type and default for pydantic; the service validates values."""
    return (
        (list[str], []) if member.many else ((member.kind if member.kind in (int, float, bool) else str) | None, None)
    )


_TEXTS: Any = create_model(
    "_TEXTS",
    __config__=ConfigDict(extra="forbid", allow_inf_nan=False),
    name=(str, ""),
    request_id=(str, ""),
    uploads=(list[str], []),
    **{member.name: _text(member) for member in members(SceneOptions)},
)


async def receive_scene(request: Request, service: SceneService, settings: Settings, threads: Threads) -> Operation:
    """Receives the form's files and queues their job; refused uploads leave nothing behind.

    Raises:
        FastSplatError: the form or a file is invalid, or a limit is exceeded.
    """

    def begin() -> _FormSink:
        announced = request.headers.get("content-length", "0")
        check_announced(int(announced) if announced.isdigit() else 0, settings.capture.max_upload_bytes)
        return _FormSink(service, settings, caller_project(), request.headers.get("content-type", ""))

    return await receive_form(request, begin, threads)


async def receive_form(
    request: Request, begin: Callable[[], Sink[bytes, _R]], threads: Threads, memory_bytes: int = 0
) -> _R:
    """Writes a request's body to a sink, which needs `memory_bytes`, and returns its result.

    Raises:
        FastSplatError: the sink or the upload limits refuse the body.
    """
    body_read = asyncio.Event()
    try:
        body = _noting_end(request.stream(), body_read)
        received = threads.receive(body, begin, size=len, memory_bytes=memory_bytes)
        return await while_connected(request, received, body_read)
    except FastSplatError:
        if "expect" not in request.headers and not body_read.is_set():
            await _drain(request)
        raise


async def _noting_end(stream: AsyncIterator[bytes], end: asyncio.Event) -> AsyncIterator[bytes]:
    async for chunk in stream:
        yield chunk
    end.set()


async def _drain(request: Request) -> None:
    """Reads up to 2 s or 32 MiB more: closing early would reset the connection."""
    total, more = 0, True
    try:
        async with asyncio.timeout(2.0):
            while more and total < 2**25:
                message = await request.receive()
                total += len(message.get("body", b""))
                more = message.get("more_body", False)
    except TimeoutError:
        pass


class _FormSink:
    """`Sink` and `PartReceiver` that write files to an upload session and keep texts in memory."""

    slow_finish = True  # validation

    def __init__(self, service: SceneService, settings: Settings, project: str, content_type: str) -> None:
        self._service = service
        self._project = project
        self._parser = FormParser(content_type, self, settings.capture.max_entries + _MAX_TEXT_PARTS)
        self._session = service.new_upload()
        self._file: UploadFile | None = None
        self._texts: dict[str, list[str]] = {}
        self._text_bytes = 0
        self._captures = 0
        self._field = ""
        self._text: bytearray | None = None

    def write(self, items: Sequence[bytes]) -> None:
        for chunk in items:
            self._parser.write(chunk)

    def finish(self) -> Operation:
        self._parser.finish()
        form = _form(self._texts)
        for upload_id in form.uploads:
            self._session.adopt(*self._service.resumable.complete(self._project, upload_id))
        options = scene_options(form.labels, form.model_dump(include=set(OPTIONS)))
        return self._service.create_scene(self._session, form.name, form.request_id, options)

    def close(self) -> None:
        self._session.abort()

    def begin_part(self, field: str, filename: str | None) -> None:
        self._field = field
        if filename is None:
            self._text = bytearray()
            return
        if field not in _FILE_FIELDS:
            raise InvalidInputError(
                f"files are not accepted under {field[:80]!r}",
                field=field[:80],
                hint='Send one archive or video as "capture", photos as "images", or a folder as "files".',
            )
        if filename:  # a browser sends an empty name when nothing was chosen
            self._captures += field == "capture"
            if self._captures > 1:
                raise InvalidInputError(
                    "more than one capture", field="capture", hint='Send single photos as "images".'
                )
            self._file = self._session.begin(filename)

    def part_data(self, data: bytes) -> None:
        if self._file is not None:
            self._file.write(data)
        elif self._text is not None:
            self._text_bytes += len(data)
            if self._text_bytes > _MAX_TEXT_BYTES:
                raise LimitExceededError(
                    "the form's text fields are too long",
                    field=self._field[:80],
                    limit=f"{_MAX_TEXT_BYTES} bytes together",
                )
            self._text += data

    def end_part(self) -> None:
        if self._file is not None:
            self._file.end()
        elif self._text is not None:
            self._texts.setdefault(self._field, []).append(self._text.decode(errors="replace"))
        self._file = self._text = None


def _form(texts: dict[str, list[str]]) -> Any:
    for field, values in texts.items():
        if field not in ("labels", "uploads") and len(values) > 1:
            raise InvalidInputError(f"{field[:80]} is there {len(values)} times", field=field[:80])
    single = {field: values if field in ("labels", "uploads") else values[0] for field, values in texts.items()}
    try:
        return _TEXTS.model_validate(single)
    except ValidationError as error:
        first = error.errors()[0]
        raise InvalidInputError(first["msg"], field=str(first["loc"][0])[:80]) from None
