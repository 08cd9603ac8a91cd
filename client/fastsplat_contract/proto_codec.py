"""The contract's types as protobuf messages and back, driven by the types. Server and client use nothing else.

Fields of one name belong together; what a type says of itself beside that stands in `wire`. A message is read into
plain dicts first, and these are checked as JSON is: bounds, and the paths that errors name, are the same.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from datetime import datetime, timezone
from functools import cache
from typing import Any, Literal, TypeVar, get_args, get_origin

from google.protobuf import json_format, struct_pb2, timestamp_pb2
from google.protobuf.message import Message

from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.json_codec import from_plain
from fastsplat_contract.members import Member, members
from fastsplat_contract.v1 import fastsplat_pb2

T = TypeVar("T")
Convert = Callable[[Any], Any]

_ABSENT = object()
_SCALARS = (bool, int, float, str, bytes)


def to_proto(value: Any) -> Any:
    """A value of the contract as the message of its type; fields that another message carries are left out.

    Raises:
        InvalidInputError: two fields of which the message holds one at most.
    """
    return _writer(type(value))(value)


def from_proto(kind: type[T], message: Message, path: str = "", carrier: Message | None = None) -> T:
    """Back from `to_proto`, checked as strictly as JSON.

    Args:
        kind: a type of the contract.
        message: of that type.
        path: names `message` in errors, e.g. "cameras[0]".
        carrier: the message that has the fields which are not in `message` itself.

    Raises:
        InvalidInputError: names the field.
    """
    plain = _reader(kind, "")(message)
    if carrier is not None:
        plain |= _reader(kind, carrier.DESCRIPTOR.name)(carrier)
    return from_plain(kind, plain, path)


def message_class(kind: Any) -> Any:
    """The generated class of a type's message."""
    form = getattr(kind, "wire", kind)
    return getattr(fastsplat_pb2, form.proto or form.__name__)


def numbers_of(literal: Any, enum: Any) -> dict[str, int]:
    """The number of each value: "mask2d" is OUTPUT_MASK2D, where the enum's first name is OUTPUT_UNSPECIFIED."""
    prefix = enum.values_by_number[0].name.removesuffix("UNSPECIFIED")
    return {value: enum.values_by_name[prefix + value.upper()].number for value in get_args(literal)}


def timestamp_of(moment: datetime) -> timestamp_pb2.Timestamp:
    """A moment as a message."""
    message = timestamp_pb2.Timestamp()
    message.FromDatetime(moment.astimezone(timezone.utc))
    return message


def _make_writer(kind: Any) -> Convert:
    made = message_class(kind)
    fields = made.DESCRIPTOR.fields_by_name
    writes = {m: _write(m, fields.get(m.name)) for m in members(kind) if not m.carried}
    as_they_are = [member.name for member, write in writes.items() if write is None]
    converted = [(member.name, write) for member, write in writes.items() if write is not None]
    choices = [[field.name for field in group.fields] for group in made.DESCRIPTOR.oneofs if len(group.fields) > 1]
    to_wire: Convert = kind.to_wire if hasattr(kind, "wire") else getattr(kind, "as_named", _same)

    def write(value: Any) -> Message:
        value = to_wire(value)
        parts = {name: getattr(value, name) for name in as_they_are}
        for name, convert in converted:
            if (part := getattr(value, name)) is not None:
                parts[name] = convert(part)
        for names in choices:
            both = [name for name in names if parts.get(name) is not None]
            if len(both) > 1:
                raise InvalidInputError(f"{' and '.join(both)} at once", field=both[0], hint="Send exactly one.")
        message: Message = made(**parts)
        return message

    return write


_writer: Callable[[Any], Convert] = cache(_make_writer)


def _write(member: Member, field: Any) -> Convert | None:
    """What makes the message's value of the member's; None where they are the same."""
    kind = member.kind
    one: Convert | None = None
    if kind is datetime:
        one = timestamp_of
    elif get_origin(kind) is Literal:
        one = numbers_of(kind, field.enum_type).__getitem__ if field.enum_type is not None else None
    elif get_origin(kind) is not None:
        one = _struct_of if get_args(kind)[1] is Any else dict
    elif hasattr(kind, "__get_pydantic_core_schema__"):
        one = _writer(kind)
    return one if one is None or not member.many else lambda values: [one(value) for value in values]


def _same(value: Any) -> Any:
    return value


def _refuse(name: str, number: int) -> Any:
    raise InvalidInputError(f"{name} of {number} is unknown", field=name, hint="The contract names those there are.")


def _struct_of(values: Mapping[str, Any]) -> struct_pb2.Struct:
    message = struct_pb2.Struct()
    message.update(dict(values))
    return message


def _make_reader(kind: Any, carrier: str) -> Convert:
    """What reads a type's own message, or the fields that `carrier` has of it, into a dict."""
    fields = (getattr(fastsplat_pb2, carrier) if carrier else message_class(kind)).DESCRIPTOR.fields_by_name
    own = {m: fields.get(m.name) for m in members(kind) if m.carried == carrier}
    plainly = [m.name for m, field in own.items() if m.kind in _SCALARS and not (m.many or field.has_presence)]
    reads = [(member.name, _read(member, field)) for member, field in own.items() if member.name not in plainly]

    def read(message: Any) -> dict[str, Any]:
        plain = {name: getattr(message, name) for name in plainly}
        for name, get in reads:
            if (value := get(message)) is not _ABSENT:
                plain[name] = value
        return plain

    return read


_reader: Callable[[Any, str], Convert] = cache(_make_reader)


def _read(member: Member, field: Any) -> Convert:
    """What takes the member's plain value out of a message; `_ABSENT` leaves it to the type's default."""
    name, kind, optional = member.name, member.kind, member.optional
    one: Convert | None = None
    if kind is datetime:
        one = lambda stamp: stamp.ToDatetime(timezone.utc)  # noqa: E731
    elif field.enum_type is not None:
        names = {number: value for value, number in numbers_of(kind, field.enum_type).items()}
        one = lambda number: names.get(number, number)  # noqa: E731 - the type refuses a number
        if member.many:
            one = lambda number: names[number] if number in names else _refuse(name, number)  # noqa: E731
    elif get_origin(kind) not in (None, Literal):
        one = json_format.MessageToDict if get_args(kind)[1] is Any else dict
    elif field.message_type is not None:
        one = _reader(kind, "")
    unspecified = field.enum_type is not None and (optional or member.default)

    def get(message: Any) -> Any:
        value = getattr(message, name)
        if member.many:
            return None if optional and not value else list(value) if one is None else [one(item) for item in value]
        if (field.has_presence and not message.HasField(name)) or (unspecified and value == 0):
            return None if optional else _ABSENT
        return value if one is None else one(value)

    return get
