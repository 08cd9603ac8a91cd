"""A server that asks for keys, keys of every kind, and every call of both protocols, from their own tables."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import NoneType
from typing import Any

import grpc
import httpx
from fastapi.routing import iter_route_contexts
from google.protobuf import message_factory

from fastsplat.api.handlers import HANDLERS
from fastsplat.api.rest.access import route_name
from fastsplat.api.rest.app import create_app
from fastsplat.api.rest.examples import BODIES
from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.settings import Settings
from fastsplat_contract.codec.json_codec import to_plain
from fastsplat_contract.codec.members import members
from fastsplat_contract.codec.proto_codec import to_proto
from fastsplat_contract.v1 import fastsplat_pb2 as pb
from tests.api.calls import CALLS
from tests.api.made_scene import OBSERVED, PLAIN_PNG, add_known_name, add_scene
from tests.api.served import Faces, served
from tests.api.training_job import add_training_job

SERVICE = "/fastsplat.v1.SceneService/"
ROUTES = {  # method and template of every route by its name
    route_name(context, method): (method, context.path)
    for context in iter_route_contexts(create_app(None, Settings()).routes)
    for method in sorted(context.methods or {"GET"})
}
RPCS = {method.name: method for method in pb.DESCRIPTOR.services_by_name["SceneService"].methods}

_TUS = {"Tus-Resumable": "1.0.0"}
_REQUESTS: dict[str, dict[str, Any]] = {
    "POST /v1/scenes/{scene_id}:query": {"json": {"texts": ["mug"]}},
    "POST /v1/scenes/{scene_id}:localize": {"files": [("photos", ("plain.png", PLAIN_PNG))]},
    "POST /v1/scenes/{scene_id}/observations": {"files": [("photos", ("plain.png", PLAIN_PNG))]},
    "POST /mcp": {
        "json": {"jsonrpc": "2.0", "id": 1, "method": "tools/list"},
        "headers": {"Accept": "application/json"},
    },
    "POST /v1/uploads": {"headers": {**_TUS, "Upload-Length": "3", "Upload-Metadata": "filename YS56aXA="}},
    "HEAD /v1/uploads/{upload_id}": {"headers": _TUS},
    "DELETE /v1/uploads/{upload_id}": {"headers": _TUS},
    "PATCH /v1/uploads/{upload_id}": {
        "headers": {**_TUS, "Content-Type": "application/offset+octet-stream", "Upload-Offset": "0"},
        "content": b"abc",
    },
}
"""What a route needs beside its path to be more than bad input; other calls that have a body: see `_BODIES`."""
_BODIES = {  # sent by a call that needs a body: the first of its examples
    handler.call.route: next(iter(BODIES[kind.__name__].values()))[1]
    for handler in HANDLERS.values()
    for kind in handler.call.request.__mro__
    if kind.__name__ in BODIES and not handler.call.body_optional
}

_OF_TRAINING = {  # calls and routes that speak of a job while it trains
    "FinishOperation",
    "GetPreview",
    "GetPlacedCameras",
    "GetJobLog",
    "GET /v1/operations/{operation_id}/log",
    "POST /v1/operations/{operation_id}:finish",
    "GET /v1/operations/{operation_id}/preview",
    "GET /v1/operations/{operation_id}/preview.jpg",
    "GET /v1/operations/{operation_id}/cameras",
}


@dataclass(frozen=True)
class Guarded:
    """The server, the keys by their holders ("none" has none, "stranger" is another project's admin), and the calls."""

    faces: Faces
    keys: dict[str, str]
    service: SceneService
    settings: Settings

    @cached_property
    def shared(self) -> dict[str, str]:
        """Ids of a scene of the default project, its job, a key, a known name and an upload, which no test changes."""
        return self.new_ids()

    def new_ids(self) -> dict[str, str]:
        """The same of new ones, which a call may change."""
        scene_id = add_scene(self.service, self.settings)
        return {
            "scene_id": scene_id,
            "operation_id": self.service.get_scene(scene_id).operation_id,
            "key_id": self.service.admin.keys.create("another", "reader")[0].id,
            "name_id": add_known_name(self.service, scene_id),
            "observation_id": OBSERVED,
            "upload_id": self.service.resumable.create("default", "a.zip", 3).id,
        }

    def ids_for(self, call: str, *, fresh: bool) -> dict[str, str]:
        """Ids for a call or a route: shared ones or new ones; one about a job that trains gets such a job."""
        ids = self.new_ids() if fresh else self.shared
        if call not in _OF_TRAINING:
            return ids
        return {**ids, "operation_id": add_training_job(self.service).operation.id}

    def header(self, caller: str) -> dict[str, str]:
        """What a caller sends to be known."""
        return {"Authorization": f"Bearer {self.keys[caller]}"} if self.keys[caller] else {}

    def metadata(self, caller: str) -> tuple[tuple[str, str], ...]:
        """The same for gRPC."""
        return tuple((name.lower(), value) for name, value in self.header(caller).items())

    def send(self, route: str, caller: str, ids: dict[str, str]) -> httpx.Response:
        """The answer of a route."""
        method, template = ROUTES[route]
        path = {"/web": "/web/icon.svg", "/docs-files": "/docs-files/swagger-ui.css"}.get(template, template)
        kind = "label_map" if path.endswith(".npy") else "rgb"
        path = path.format(**ids, kind=kind, format="spz")
        request = _REQUESTS.get(route) or ({"json": to_plain(_BODIES[route])} if route in _BODIES else {})
        headers = {**request.get("headers", {}), **self.header(caller)}
        params = {"text": "mug", "view": "front.png"} if template != "/query" else {"text": "mug"}
        return self.faces.rest.request(method, path, params=params, **{**request, "headers": headers})

    def call(self, name: str, caller: str, ids: dict[str, str]) -> grpc.RpcError | None:
        """The error of an RPC; None: it was answered."""
        method = RPCS[name]
        message = _message(name, message_factory.GetMessageClass(method.input_type), ids)
        call: Callable[..., Any] = getattr(self.faces.rpc, name)
        sent = iter([message]) if method.client_streaming else message
        try:
            answer = call(sent, metadata=self.metadata(caller), timeout=30)
            if method.server_streaming:
                list(answer)
        except grpc.RpcError as error:
            return error
        return None

    def assert_shared_untouched(self) -> None:
        ids = self.shared
        scene = self.service.get_scene(ids["scene_id"])
        assert (scene.state, scene.version, scene.name) == ("READY", "1", "made")
        assert self.service._store.keys.find(ids["key_id"]).valid(time.time() + 7200)
        assert self.service.resumable.get("default", ids["upload_id"]).offset == 0


@contextmanager
def guarded_server(api_settings: Settings, folder: Path) -> Iterator[Guarded]:
    settings = api_settings.model_copy(update={"auth": "on", "data_dir": folder})
    with open_service(settings) as service, served(service, settings) as faces:
        service.admin.projects.create("elsewhere")
        make = service.admin.keys.create
        keys = {
            role: make(role, role)[1] for role in ("uploader", "suggester", "reader", "editor", "admin", "operator")
        }
        revoked, keys["revoked"] = make("revoked", "operator")
        service.admin.keys.revoke(revoked.id)
        keys["stranger"] = make("stranger", "admin", project="elsewhere")[1]
        yield Guarded(faces, {**keys, "none": ""}, service, settings)


def without_ids(text: str) -> str:
    """A text with every id in it replaced by the same word."""
    return re.sub(r"\b([0-9a-f]{32}|[0-9a-f]{12})(-\d+)?\b", "ID", text)


def about_one(rpc: str) -> bool:
    """Whether an RPC is about one scene, job, key, name or upload."""
    if rpc in ("StreamQuery", "ListKeys"):  # a scene there narrows the list of the caller's own keys
        return rpc == "StreamQuery"
    fields = message_factory.GetMessageClass(RPCS[rpc].input_type).DESCRIPTOR.fields_by_name
    return any(name in fields for name in ("scene_id", "operation_id", "key_id", "name_id", "upload_id"))


def _message(name: str, kind: Any, ids: dict[str, str]) -> Any:
    if name == "StreamQuery":
        query = pb.QueryRequest(scene_id=ids["scene_id"], texts=["mug"])
        return pb.StreamQueryRequest(question=pb.Subscription(query=query))
    if name == "CreateScene":
        return pb.CreateSceneRequest(header=pb.CreateSceneHeader())
    call = CALLS[name]
    if call.request is NoneType:
        return kind()
    body = vars(_BODIES[call.route]) if call.route in _BODIES else {}
    values = {
        "text": "mug",
        "texts": ("mug",),
        "view": "front.png",
        "kind": "rgb",
        "photos": 3 if name == "EstimateJob" else (PLAIN_PNG,),
        **body,
        **ids,
        "request_id": "",  # that of an example would stand for the same call about another scene
    }
    if name == "CreateKey":
        values["role"] = "reader"  # one that shows a scene alone may do no more
    fields = {member.name for member in members(call.request)}
    return to_proto(call.request(**{field: value for field, value in values.items() if field in fields}))
