"""`POST /v1/scenes/{id}:localize` and `/observations`: photo forms, received in memory."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any, Generic, TypeVar

from fastapi import APIRouter, Request
from starlette.responses import Response

from fastsplat.api.access.caller import caller_id
from fastsplat.api.rest.responses import PROBLEMS, json_of_call
from fastsplat.api.rest.routes.multipart import FormParser
from fastsplat.api.rest.routes.upload import receive_form
from fastsplat.api.threads import Threads
from fastsplat.service.application.answering.localizing import MAX_PHOTOS_BYTES, too_many_bytes
from fastsplat.service.application.service import SceneService
from fastsplat.service.localization.localization_settings import LocalizationSettings
from fastsplat.service.settings import Settings
from fastsplat_contract.codec.json_codec import from_plain, json_schema_of
from fastsplat_contract.codec.members import description_of
from fastsplat_contract.errors import InvalidInputError, LimitExceededError
from fastsplat_contract.geometry.poses import Pose
from fastsplat_contract.photos.localization import Localization, LocalizeRequest
from fastsplat_contract.photos.observations import Observation, ObserveRequest

_LISTS = ("focals", "poses")
_TEXTS: Mapping[type[Any], tuple[str, ...]] = {
    LocalizeRequest: (*_LISTS, "version"),
    ObserveRequest: (*_LISTS, "seen_at", "request_id"),
}
"""Text fields of each form; those outside `_LISTS` may occur once."""
T = TypeVar("T")
_MAX_TEXT_BYTES = 2**16
_MAX_PARTS = 1_000


def _property(kind: type[Any], name: str, items: dict[str, Any] | None) -> dict[str, Any]:
    said = {"description": description_of(kind, name)}
    return {"type": "string", **said} if items is None else {"type": "array", "items": items, **said}


_POSE_TEXT = {
    "type": "string",
    "contentMediaType": "application/json",
    "description": 'one as JSON: {"position": {"x", "y", "z"}, "orientation": {"x", "y", "z", "w"}}',
}


def _body_schema(kind: type[Any]) -> dict[str, Any]:
    """Builds a form's OpenAPI schema, because the route reads the stream itself."""
    items = {"photos": {"type": "string", "format": "binary"}, "focals": {"type": "number"}, "poses": _POSE_TEXT}
    properties = {name: _property(kind, name, items.get(name)) for name in ("photos", *_TEXTS[kind])}
    if "seen_at" in properties:
        properties["seen_at"]["format"] = "date-time"
    schema = {"type": "object", "required": ["photos"], "properties": properties}
    return {"requestBody": {"required": True, "content": {"multipart/form-data": {"schema": schema}}}}


def localize_routes(service: SceneService, settings: Settings, threads: Threads) -> APIRouter:
    """Builds the routes of visual localization and observations."""
    router = APIRouter(prefix="/v1", responses=PROBLEMS)

    async def received(request: Request, scene_id: str, kind: type[T]) -> T:
        limits, content_type = settings.localization, request.headers.get("content-type", "")
        return await receive_form(
            request, lambda: _PhotoSink(kind, scene_id, limits, content_type), threads, memory_bytes=MAX_PHOTOS_BYTES
        )

    @router.post(
        "/scenes/{scene_id}:localize", response_model=Localization, openapi_extra=_body_schema(LocalizeRequest)
    )
    async def localize(request: Request, scene_id: str) -> Response:
        """Where photos were taken in a scene, what is seen from there, and what has changed."""
        message = await received(request, scene_id, LocalizeRequest)
        return await json_of_call(request, threads.answer, lambda: service.localizing.localize(message))

    @router.post(
        "/scenes/{scene_id}/observations", response_model=Observation, openapi_extra=_body_schema(ObserveRequest)
    )
    async def observe_scene(request: Request, scene_id: str) -> Response:
        """Keep photos of another day, and what they show to be gone, moved, new or changed, with a scene."""
        message = await received(request, scene_id, ObserveRequest)
        author = caller_id()
        return await json_of_call(request, threads.call, lambda: service.observations.observe(message, author))

    return router


class _PhotoSink(Generic[T]):
    """`Sink` and `PartReceiver` that collect the form's parts in memory."""

    slow_finish = False

    def __init__(self, kind: type[T], scene_id: str, limits: LocalizationSettings, content_type: str) -> None:
        self._kind = kind
        self._scene_id = scene_id
        self._limits = limits
        self._parser = FormParser(content_type, self, _MAX_PARTS)
        self._photos: list[bytearray] = []
        self._texts: dict[str, list[bytearray]] = {name: [] for name in _TEXTS[kind]}
        self._size = self._text_size = 0
        self._part = bytearray()
        self._field = ""

    def write(self, items: Sequence[bytes]) -> None:
        for chunk in items:
            self._parser.write(chunk)

    def finish(self) -> T:
        self._parser.finish()
        texts = {name: [part.decode(errors="replace") for part in parts] for name, parts in self._texts.items()}
        once = {name: parts for name, parts in texts.items() if name not in _LISTS}
        for name, parts in once.items():
            if len(parts) > 1:
                raise InvalidInputError(f"{name} is there {len(parts)} times", field=name)
        plain = {
            "scene_id": self._scene_id,
            "photos": [bytes(photo) for photo in self._photos],
            "focals": [_number(text, f"focals[{number}]") for number, text in enumerate(texts["focals"])],
            "poses": [_json(text, f"poses[{number}]") for number, text in enumerate(texts["poses"])],
            **{name: parts[0] for name, parts in once.items() if parts},
        }
        return from_plain(self._kind, plain)

    def close(self) -> None:
        self._photos.clear()

    def begin_part(self, field: str, filename: str | None) -> None:
        self._field, self._part = field, bytearray()
        if field == "photos":
            if len(self._photos) == self._limits.max_photos:
                raise LimitExceededError(
                    f"more than {self._limits.max_photos} photos",
                    field="photos",
                    limit=f"{self._limits.max_photos} photos (FASTSPLAT_LOCALIZATION__MAX_PHOTOS)",
                    hint="Send them in several requests.",
                )
            self._photos.append(self._part)
        elif field in self._texts and filename is None:
            self._texts[field].append(self._part)
        else:
            raise InvalidInputError(
                f"the form has no field {field[:80]!r}",
                field=field[:80],
                hint=f'Send image files as "photos", and {", ".join(self._texts)} as texts.',
            )

    def part_data(self, data: bytes) -> None:
        if self._field == "photos":
            self._size += len(data)
            if self._size > MAX_PHOTOS_BYTES:
                raise too_many_bytes(self._size)
        else:
            self._text_size += len(data)
            if self._text_size > _MAX_TEXT_BYTES:
                raise LimitExceededError(
                    "the form's text fields are too long", field=self._field, limit=f"{_MAX_TEXT_BYTES} bytes together"
                )
        self._part += data

    def end_part(self) -> None:
        self._part = bytearray()


def _number(text: str, field: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise InvalidInputError(f"{text[:80]!r} is no number", field=field, hint="Send pixels, e.g. 1200.5.") from None


def _json(text: str, field: str) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        known = ", ".join(json_schema_of(Pose)["properties"])
        raise InvalidInputError(f"{text[:80]!r} is no JSON", field=field, hint=f"Send an object of {known}.") from None
