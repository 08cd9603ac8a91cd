"""Python, JSON (OpenAPI) and protobuf say the same of every field of every type: name, presence, type, description.

A field that was forgotten somewhere fails here by its name.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Mapping
from datetime import datetime
from functools import cache
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import grpc_tools
import pytest
from google.protobuf import descriptor_pb2
from grpc_tools import protoc

from fastsplat_contract.members import Member, members
from fastsplat_contract.proto_codec import message_class, numbers_of
from fastsplat_contract.v1 import fastsplat_pb2
from tests.contract.catalog import TYPES
from tests.contract.values import JSON_ONLY

_ROOT = Path(__file__).resolve().parents[2]
_OPENAPI = json.loads((_ROOT / "api/rest/openapi.json").read_text())
_SCALARS: Mapping[Any, tuple[str, tuple[str, ...]]] = {
    bool: ("boolean", ("BOOL",)),
    int: ("integer", ("INT32", "INT64")),
    float: ("number", ("DOUBLE",)),
    str: ("string", ("STRING",)),
    bytes: ("string", ("BYTES",)),
    datetime: ("string", ("MESSAGE",)),
}

_NOT_IN_OPENAPI = {
    "SceneOptions",  # fields of a multipart form
    "LocalizeRequest",  # fields of a multipart form
    "ListOperations",  # parameters of a URL
    "CameraFileRequest",
    "ExportRequest",
    "QueryRequest",  # QueryIn is its body
    "PictureRequest",  # RenderIn is its body
    "PickRequest",  # PickIn is its body
    "MeasureRequest",  # MeasureIn is its body
}
_NOT_IN_PYTHON = {
    # messages of one id or of a page, which the servicer reads as they are
    "CancelOperationRequest",
    "DeleteSceneRequest",
    "DownloadMaskPlyRequest",
    "DownloadScenePlyRequest",
    "DownloadThingIdsRequest",
    "DownloadPhotoRequest",
    "ListBestViewsRequest",
    "ListNextPhotosRequest",
    "GetGoalRequest",
    "ListDetectionsRequest",
    "ListPhotosRequest",
    "GetOperationRequest",
    "FinishOperationRequest",
    "GetPreviewRequest",
    "GetPlacedCamerasRequest",
    "GetSceneRequest",
    "DeleteKnownNameRequest",
    "DeleteKnownNamesRequest",
    "ListKeysRequest",
    "ListKnownNamesRequest",
    "ListLabelsRequest",
    "ListObjectsRequest",
    "ListPhotoVerdictsRequest",
    "ListScenesRequest",
    "ListThingsRequest",
    "ListVersionsRequest",
    "RevokeKeyRequest",
    "WaitOperationRequest",
    "WatchOperationRequest",
    # how a stream is cut into messages
    "Chunk",
    "CreateSceneRequest",
    "FileHeader",
    "QueryResponse",
    "Accepted",
    "DroppedPoses",
    "Heartbeat",
    "PoseDone",
    "StandingQuestion",
    "StreamPose",
    "StreamQueryRequest",
    "StreamQueryResponse",
}
_FIELDS_OF_THE_MESSAGE_ALONE = {
    ("CreateSceneHeader", "name"),  # beside the options
    ("CreateSceneHeader", "request_id"),
    ("EditSceneRequest", "scene_id"),  # REST has it in the path
    ("LookAgainRequest", "scene_id"),
    ("TrainMoreRequest", "scene_id"),
    ("AlignSceneRequest", "scene_id"),
    ("UpdateSceneRequest", "scene_id"),
    ("UndoEditRequest", "scene_id"),
    ("RedoEditRequest", "scene_id"),
    ("RestoreVersionRequest", "scene_id"),
    ("RetryOperationRequest", "operation_id"),
    ("ExpireKeyRequest", "key_id"),
    ("QueryRequest", "scene_id"),
    ("RenderViewRequest", "scene_id"),
    ("PickThingRequest", "scene_id"),
    ("MeasureRequest", "scene_id"),
    ("ViewMask", "continues"),  # of a mask that is cut into pieces
}
_EMPTY_IS_ABSENT = {"Answer.objects"}
"""None in Python and null in JSON; in protobuf, where lists have no presence, the request says what was asked for."""


@pytest.mark.parametrize("name", [name for name in TYPES if name not in _NOT_IN_OPENAPI])
def test_json_has_the_same_fields(name: str) -> None:
    schema = _OPENAPI["components"]["schemas"][name]
    assert schema["description"] == " ".join((TYPES[name].__doc__ or "").split())
    properties = schema["properties"]
    declared = {member.name: member for member in members(TYPES[name])}
    for field in set(properties) ^ set(declared):
        pytest.fail(f"openapi.json and the type differ in {name}.{field}")
    for field, member in declared.items():
        where, said = f"{name}.{field}", properties[field]
        assert said.get("description", "") == member.description, where
        assert _json_type(said) == _expected_json(member), where
        required = field in schema.get("required", ())
        answer = schema.get("additionalProperties", True) is not False
        assert required is ((answer and name != "Problem") or not member.default), where


def _json_type(said: Mapping[str, Any]) -> tuple[Any, bool]:
    """Type and whether null is allowed."""
    choices = said.get("anyOf", [said])
    (one,) = (choice for choice in choices if choice.get("type") != "null")
    return _json_kind(one), len(choices) > 1


def _json_kind(one: Mapping[str, Any]) -> Any:
    if "$ref" in one:
        return one["$ref"].rpartition("/")[2]
    if "enum" in one:
        return tuple(one["enum"])
    if one["type"] == "array":
        return [_json_kind(one["items"])]
    return "date-time" if one.get("format") == "date-time" else one["type"]


def _expected_json(member: Member) -> tuple[Any, bool]:
    kind = member.kind
    if get_origin(kind) is Literal:
        one: Any = get_args(kind)
    elif kind is datetime:
        one = "date-time"
    elif get_origin(kind) is not None:
        one = "object"
    else:
        one = _SCALARS[kind][0] if kind in _SCALARS else getattr(kind, "wire", kind).__name__
    return ([one] if member.many else one), member.optional


@pytest.mark.parametrize("name", [name for name, kind in TYPES.items() if kind not in JSON_ONLY])
def test_protobuf_has_the_same_fields(name: str) -> None:
    descriptor = message_class(TYPES[name]).DESCRIPTOR
    fields = dict(descriptor.fields_by_name)
    for member in members(TYPES[name]):
        carrier = getattr(fastsplat_pb2, member.carried).DESCRIPTOR.fields_by_name if member.carried else fields
        assert member.name in carrier, f"{name}.{member.name} is not in message {member.carried or descriptor.name}"
        _check_field(f"{name}.{member.name}", member, carrier[member.name])
    names = {member.name for member in members(TYPES[name])}
    for field in set(fields) - names:
        wider = {m.name for kind in TYPES.values() if _message_name(kind) == descriptor.name for m in members(kind)}
        known = field in wider or (descriptor.name, field) in _FIELDS_OF_THE_MESSAGE_ALONE
        assert known, f"message {descriptor.name} has {field}, {name} has not"


def _message_name(kind: Any) -> str:
    return "" if kind in JSON_ONLY else str(message_class(kind).DESCRIPTOR.name)


def _check_field(where: str, member: Member, field: Any) -> None:
    kind, message = member.kind, field.message_type
    is_map = message is not None and message.GetOptions().map_entry
    assert field.is_repeated == (member.many or is_map), where
    if member.many:
        assert not member.optional or where in _EMPTY_IS_ABSENT, where
    elif message is None:
        assert field.has_presence == member.optional, where
    if get_origin(kind) is Literal and field.enum_type is not None:
        numbers = numbers_of(kind, field.enum_type)
        assert set(numbers.values()) | {0} == set(field.enum_type.values_by_number), where
    elif get_origin(kind) is Literal:
        assert field.type == field.TYPE_STRING, where
    elif kind in _SCALARS:
        allowed = {getattr(field, f"TYPE_{kind_name}") for kind_name in _SCALARS[kind][1]}
        assert field.type in allowed, where
        assert kind is not datetime or message.full_name == "google.protobuf.Timestamp", where
    elif get_origin(kind) is not None:
        value = get_args(kind)[1]
        assert message.full_name == "google.protobuf.Struct" if value is Any else is_map, where
        assert value is Any or message.fields_by_name["value"].type in (field.TYPE_DOUBLE, field.TYPE_STRING), where
    else:
        assert message is message_class(kind).DESCRIPTOR, where


def test_every_message_is_a_type_or_part_of_the_transport() -> None:
    messages = set(fastsplat_pb2.DESCRIPTOR.message_types_by_name)
    typed = {_message_name(kind) for kind in TYPES.values()} - {""}
    assert messages == typed | _NOT_IN_PYTHON and not typed & _NOT_IN_PYTHON


def test_every_schema_is_a_type() -> None:
    assert set(_OPENAPI["components"]["schemas"]) == set(TYPES) - _NOT_IN_OPENAPI


@pytest.mark.parametrize("name", [name for name, kind in TYPES.items() if kind not in JSON_ONLY])
def test_protobuf_says_the_same_of_each_field(name: str) -> None:
    own = message_class(TYPES[name]).DESCRIPTOR.name
    for member in members(TYPES[name]):
        assert _comments()[member.carried or own, member.name] == member.description, f"{name}.{member.name}"
    if name == own:
        assert _comments()[own, ""] == " ".join((TYPES[name].__doc__ or "").split())


@cache
def _comments() -> Mapping[tuple[str, str], str]:
    """What the .proto file says of each message, under "", and of each field, behind it or above it, on one line."""
    bundled = Path(grpc_tools.__file__).parent / "_proto"
    with tempfile.NamedTemporaryFile() as file:
        arguments = [f"-I{_ROOT / 'protos'}", f"-I{bundled}", f"-o{file.name}", "--include_source_info"]
        assert protoc.main(["protoc", *arguments, "fastsplat/v1/fastsplat.proto"]) == 0
        (proto,) = descriptor_pb2.FileDescriptorSet.FromString(Path(file.name).read_bytes()).file
    comments: dict[tuple[str, str], str] = {}
    for place in proto.source_code_info.location:
        text = " ".join((place.leading_comments or place.trailing_comments).split())
        match list(place.path):
            case [4, message]:
                comments[proto.message_type[message].name, ""] = text
            case [4, message, 2, field]:
                declared = proto.message_type[message]
                comments[declared.name, declared.field[field].name] = text
    return comments
