"""Resumable uploads by tus 1.0.0: creation, creation-with-upload, checksum, expiration, termination."""

from __future__ import annotations

import base64
import binascii
import hashlib
from collections.abc import Awaitable, Callable, Sequence
from email.utils import formatdate
from functools import partial, wraps
from typing import Any

from fastapi import APIRouter, Request
from starlette.responses import Response

from fastsplat.api.access.caller import caller_project
from fastsplat.api.rest.problem_answers import problem_response
from fastsplat.api.rest.responses import PROBLEMS
from fastsplat.api.threads import Threads
from fastsplat.service.application.service import SceneService
from fastsplat.service.application.uploading.resumable import ResumableUploads
from fastsplat.service.application.uploading.upload_piece import ALGORITHMS, Algorithm
from fastsplat.service.store.repositories.upload_repository import UploadRecord
from fastsplat_contract.errors import FastSplatError, InvalidInputError, TusVersionError, UnsupportedMediaTypeError

_VERSION = "1.0.0"
_PIECE = "application/offset+octet-stream"
_MAX_METADATA = 4_096
_BODY: dict[str, Any] = {"requestBody": {"content": {_PIECE: {"schema": {"type": "string", "format": "binary"}}}}}


_Handler = Callable[..., Awaitable[Response]]


def tus_routes(service: SceneService, threads: Threads, max_bytes: int, root_path: str) -> APIRouter:
    """Builds the routes of https://tus.io/protocols/resumable-upload."""
    router = APIRouter(prefix="/v1/uploads", responses=PROBLEMS)

    @router.options("", status_code=204, response_class=Response)
    async def describe_uploads() -> Response:
        """What of tus is spoken here."""
        headers = {
            "Tus-Resumable": _VERSION,
            "Tus-Version": _VERSION,
            "Tus-Extension": "creation,creation-with-upload,checksum,expiration,termination",
            "Tus-Max-Size": str(max_bytes),
            "Tus-Checksum-Algorithm": ",".join(ALGORITHMS),
        }
        return Response(status_code=204, headers=headers)

    @router.post("", status_code=201, response_class=Response, openapi_extra=_BODY)
    @_spoken
    async def create_upload(request: Request) -> Response:
        """Announce a file by Upload-Length and Upload-Metadata (`filename`); its first bytes may come along."""
        project, length, metadata = caller_project(), _number(request, "Upload-Length"), _metadata(request)
        uploads = service.resumable
        with_bytes = "content-type" in request.headers and request.headers.get("content-length") != "0"
        if with_bytes:
            _check_type(request)
        checksum = _checksum(request)
        upload = await threads.call(lambda: uploads.create(project, _filename(metadata), length, metadata))
        if with_bytes:
            sink = partial(_PieceSink, uploads, project, upload.id, 0, checksum)
            upload = await threads.receive(aiter(request.stream()), sink, size=len)
        return _response(201, upload, Location=f"{root_path}/v1/uploads/{upload.id}")

    @router.head("/{upload_id}", status_code=200, response_class=Response)
    @_spoken
    async def get_upload(request: Request, upload_id: str) -> Response:
        """How far an upload has come: Upload-Offset of Upload-Length bytes."""
        project, uploads = caller_project(), service.resumable
        upload = await threads.call(lambda: uploads.get(project, upload_id))
        more = {"Upload-Metadata": upload.metadata} if upload.metadata else {}
        return _response(200, upload, **{"Upload-Length": str(upload.length), "Cache-Control": "no-store"}, **more)

    @router.patch("/{upload_id}", status_code=204, response_class=Response, openapi_extra=_BODY)
    @_spoken
    async def append_to_upload(request: Request, upload_id: str) -> Response:
        """The bytes from Upload-Offset on; what the answer's Upload-Offset counts is durable."""
        _check_type(request)
        project, offset, checksum = caller_project(), _number(request, "Upload-Offset"), _checksum(request)
        sink = partial(_PieceSink, service.resumable, project, upload_id, offset, checksum)
        return _response(204, await threads.receive(aiter(request.stream()), sink, size=len))

    @router.delete("/{upload_id}", status_code=204, response_class=Response)
    @_spoken
    async def delete_upload(request: Request, upload_id: str) -> Response:
        """Forget an upload."""
        project, uploads = caller_project(), service.resumable
        await threads.call(lambda: uploads.delete(project, upload_id))
        return Response(status_code=204, headers={"Tus-Resumable": _VERSION})

    return router


class _PieceSink:
    """`Sink` of one piece of an upload."""

    slow_finish = False

    def __init__(
        self,
        uploads: ResumableUploads,
        project: str,
        upload_id: str,
        offset: int,
        checksum: tuple[Algorithm, bytes] | None,
    ) -> None:
        self._uploads, self._project, self._upload_id = uploads, project, upload_id
        self._piece = uploads.begin_piece(project, upload_id, offset, checksum)

    def write(self, items: Sequence[bytes]) -> None:
        self._piece.write(b"".join(items))

    def finish(self) -> UploadRecord:
        self._piece.finish()
        self._piece.close()
        return self._uploads.get(self._project, self._upload_id)

    def close(self) -> None:
        self._piece.close()


def _spoken(handler: _Handler) -> _Handler:
    """Refuses other protocol versions and adds the version headers to errors."""

    @wraps(handler)
    async def spoken(request: Request, **path: str) -> Response:
        try:
            version = request.headers.get("tus-resumable", "")
            if version != _VERSION:
                raise TusVersionError(
                    f"tus version {version[:20]!r}",
                    field="Tus-Resumable",
                    limit=_VERSION,
                    hint=f"Send the header Tus-Resumable: {_VERSION}.",
                )
            return await handler(request, **path)
        except FastSplatError as error:
            answer = problem_response(request.state.request_id, error)
            answer.headers["Tus-Resumable"] = answer.headers["Tus-Version"] = _VERSION
            return answer

    return spoken


def _response(status: int, upload: UploadRecord, **headers: str) -> Response:
    common = {
        "Tus-Resumable": _VERSION,
        "Upload-Offset": str(upload.offset),
        "Upload-Expires": formatdate(upload.expires_at, usegmt=True),
    }
    return Response(status_code=status, headers={**common, **headers})


def _number(request: Request, header: str) -> int:
    value = request.headers.get(header, "")
    if not (value.isascii() and value.isdigit() and len(value) <= 18):
        raise InvalidInputError(f"{header} is {value[:40]!r}", field=header, hint="Send a number of bytes.")
    return int(value)


def _check_type(request: Request) -> None:
    kind = request.headers.get("content-type", "")
    if kind != _PIECE:
        raise UnsupportedMediaTypeError(
            f"the body has type {kind[:80]!r}", field="Content-Type", hint=f"Send it as {_PIECE}."
        )


def _checksum(request: Request) -> tuple[Algorithm, bytes] | None:
    header = request.headers.get("upload-checksum")
    if header is None:
        return None
    name, _, value = header.partition(" ")
    for algorithm in ALGORITHMS:
        if name == algorithm and len(digest := _decoded(value, "Upload-Checksum")) == hashlib.new(name).digest_size:
            return algorithm, digest
    raise InvalidInputError(
        f"checksum algorithm {name[:40]!r} is not known",
        field="Upload-Checksum",
        hint=f"Use {' or '.join(ALGORITHMS)}.",
    )


def _metadata(request: Request) -> str:
    header = request.headers.get("upload-metadata", "")
    if len(header) > _MAX_METADATA or not header.isascii():
        raise InvalidInputError(
            "the metadata is too long or not ASCII", field="Upload-Metadata", limit=f"{_MAX_METADATA} characters"
        )
    return header


def _filename(metadata: str) -> str:
    for pair in metadata.split(","):
        name, _, value = pair.strip().partition(" ")
        if name == "filename":
            try:
                return _decoded(value, "Upload-Metadata").decode()
            except UnicodeDecodeError:
                break
    raise InvalidInputError(
        "the metadata names no file",
        field="Upload-Metadata",
        hint='Send "filename" with the name in base64, e.g. Y2FwdHVyZS56aXA= for capture.zip.',
    )


def _decoded(value: str, field: str) -> bytes:
    try:
        return base64.b64decode(value, validate=True)
    except (binascii.Error, ValueError):
        raise InvalidInputError(f"{value[:80]!r} is not base64", field=field) from None
