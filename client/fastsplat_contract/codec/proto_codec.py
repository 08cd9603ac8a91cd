"""The contract's types as protobuf messages and back, driven by the types. Server and client use nothing else.

Fields of one name belong together; what a type says of itself beside that stands in `wire`. A message is read into
plain dicts first, and these are checked as JSON is: bounds, and the paths that errors name, are the same.
"""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime, timezone
from functools import cache
from typing import Any, TypeVar, get_args, get_origin

from google.protobuf import json_format
from google.protobuf.message import Message

from fastsplat_contract.codec.json_codec import from_plain
from fastsplat_contract.codec.members import Member, members
from fastsplat_contract.errors import InvalidInputError
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
    """Reads what `to_proto` made, as strictly as `from_plain`; `carrier` has the fields that `message` lacks."""
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


def _make_writer(kind: Any) -> Convert:
    message_type = message_class(kind)
    fields = message_type.DESCRIPTOR.fields_by_name
    converters = [(m.name, m.many, _converters(m, fields[m.name])[0]) for m in members(kind) if not m.carried]
    as_they_are = [name for name, _, convert in converters if convert is None]
    choices = [
        [field.name for field in group.fields] for group in message_type.DESCRIPTOR.oneofs if len(group.fields) > 1
    ]
    to_wire: Convert = kind.to_wire if hasattr(kind, "wire") else getattr(kind, "as_named", lambda value: value)

    def write(value: Any) -> Message:
        value = to_wire(value)
        parts = {name: getattr(value, name) for name in as_they_are}
        for name, many, convert in converters:
            if convert is not None and (part := getattr(value, name)) is not None:
                parts[name] = [convert(item) for item in part] if many else convert(part)
        for names in choices:
            both = [name for name in names if parts.get(name) is not None]
            if len(both) > 1:
                raise InvalidInputError(f"{' and '.join(both)} at once", field=both[0], hint="Send exactly one.")
        message: Message = message_type(**parts)
        return message

    return write


def _make_reader(kind: Any, carrier: str) -> Convert:
    """What reads a type's own message, or the fields that `carrier` has of it, into a dict."""
    fields = (getattr(fastsplat_pb2, carrier) if carrier else message_class(kind)).DESCRIPTOR.fields_by_name
    field_of = {m: fields[m.name] for m in members(kind) if m.carried == carrier}
    as_they_are = [m.name for m, field in field_of.items() if m.kind in _SCALARS and not (m.many or field.has_presence)]
    gets = [(member.name, _get(member, field)) for member, field in field_of.items() if member.name not in as_they_are]

    def read(message: Any) -> dict[str, Any]:
        plain = {name: getattr(message, name) for name in as_they_are}
        for name, get in gets:
            if (value := get(message)) is not _ABSENT:
                plain[name] = value
        return plain

    return read


_writer: Callable[[Any], Convert] = cache(_make_writer)
_reader: Callable[[Any, str], Convert] = cache(_make_reader)


def _get(member: Member, field: Any) -> Convert:
    """What takes a member's plain value out of a message; `_ABSENT` leaves it to the type's default."""
    name, optional, convert = member.name, member.optional, _converters(member, field)[1]
    unspecified = field.enum_type is not None and (optional or member.default)

    def get(message: Any) -> Any:
        value = getattr(message, name)
        if member.many:
            return None if optional and not value else [convert(item) for item in value] if convert else list(value)
        if (field.has_presence and not message.HasField(name)) or (unspecified and value == 0):
            return None if optional else _ABSENT
        return convert(value) if convert else value

    return get


def _converters(member: Member, field: Any) -> tuple[Convert | None, Convert | None]:
    """What makes the message's value of the member's (of one of many), and back; None where they are the same."""
    if field.enum_type is not None:
        numbers = numbers_of(member.kind, field.enum_type)
        names = {number: value for value, number in numbers.items()}

        def named(number: int) -> Any:
            if member.many and number not in names:
                raise InvalidInputError(f"{member.name} of {number} is unknown", field=member.name)
            return names.get(number, number)  # a number without a name is refused by the type

        return numbers.__getitem__, named
    if member.kind is datetime:
        return None, lambda stamp: stamp.ToDatetime(timezone.utc)
    if field.message_type is None:
        return None, None
    if get_origin(member.kind) is None:
        return _writer(member.kind), _reader(member.kind, "")
    return None, json_format.MessageToDict if get_args(member.kind)[1] is Any else dict
