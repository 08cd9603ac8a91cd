"""The table of calls as tests make them: in process, over REST, over gRPC."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from types import NoneType
from typing import Any, NamedTuple

import grpc
import httpx
from google.protobuf import empty_pb2

from fastsplat.api.access.caller import Principal, current_principal
from fastsplat.api.handlers import HANDLERS
from fastsplat.service.application.service import SceneService
from fastsplat_contract import calls
from fastsplat_contract.call import Call
from fastsplat_contract.codec.json_codec import from_json, to_plain
from fastsplat_contract.codec.proto_codec import from_proto, to_proto
from fastsplat_contract.errors import FastSplatError
from tests.api.served import Faces, rest_refusal, rpc_refusal

Ids = Mapping[str, str]
Request = Any  # fields by name, or a request of the contract, in full or as REST's body has it

CALLS: Mapping[str, Call[Any, Any]] = {call.rpc: call for call in calls.CALLS}
ELSEWHERE = {  # calls without examples, and where they are the same over both protocols
    *("Query", "StreamQuery", "WatchOperation"),  # answered in pieces
    *("CreateScene", "Localize", "ObserveScene"),  # forms, pieces: see test_api_uploads, _localize, _observations
    "OpenSample",  # the same scene for all who ask: see test_api_sample
    *("CreateKey", "CreateUploadKey", "ListKeys", "RevokeKey"),  # see test_api_keys
}


class Refused(NamedTuple):
    """An error, in the words that all have for it."""

    reason: str
    detail: str
    details: Mapping[str, str]


def request_of(name: str, ids: Ids, request: Request) -> Any:
    """A call's request in full, about the scene or job of `ids`."""
    kind = CALLS[name].request
    if kind is NoneType:
        return None
    if isinstance(request, kind):
        return replace(request, **ids)
    return kind(**{**(request if isinstance(request, Mapping) else vars(request)), **ids})


def in_process(service: SceneService, name: str, ids: Ids, request: Request) -> Any:
    """What the service answers, or how it refuses."""
    sent = request_of(name, ids, request)
    token = current_principal.set(Principal("", "default", "operator"))
    try:
        return _WRITTEN[name](service, sent) if name in _WRITTEN else HANDLERS[name].ask(service, sent)
    except FastSplatError as error:
        return Refused(error.reason, error.message, error.details())
    finally:
        current_principal.reset(token)


_WRITTEN: Mapping[str, Any] = {  # calls of which each protocol makes more than their answer
    "WaitOperation": lambda service, sent: service.get_operation(sent.operation_id),
    "DownloadPhoto": lambda service, sent: service.photos.path(sent.scene_id, sent.view)[0].read_bytes(),
}


def over_rest(faces: Faces, name: str, ids: Ids, request: Request) -> Any:
    """The same over HTTP."""
    call = CALLS[name]
    method, template = call.route.split(" ")
    fields = {} if call.request is NoneType else to_plain(request_of(name, ids, request))
    path = re.sub(r"{(\w+)}", lambda named: fields.pop(named[1]), template)
    if method in ("POST", "PATCH"):
        response = faces.rest.request(method, path, json=fields)
    else:
        sent = {key: value for key, value in fields.items() if value not in (None, "")}
        response = faces.rest.request(method, path, params=sent)
    return _read(call, response)


def _read(call: Call[Any, Any], response: httpx.Response) -> Any:
    if not response.is_success:
        refusal = rest_refusal(response)
        return Refused(refusal.reason, refusal.detail, refusal.details)
    if call.response in (bytes, NoneType):
        return response.content if response.status_code != 204 else None
    return from_json(call.response, response.content)


def over_grpc(faces: Faces, name: str, ids: Ids, request: Request) -> Any:
    """The same over gRPC."""
    call = CALLS[name]
    message = empty_pb2.Empty() if call.request is NoneType else to_proto(request_of(name, ids, request))
    try:
        answer = getattr(faces.rpc, name)(message, timeout=60)
        if call.response is bytes:
            return b"".join(chunk.data for chunk in answer)
    except grpc.RpcError as error:
        refusal = rpc_refusal(error)
        return Refused(refusal.reason, refusal.detail, refusal.details)
    return from_proto(call.response, answer) if call.response is not NoneType else None
