"""What a release has sent, later ones read: no name of its wire gets another number or type, or another use."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from google.protobuf.descriptor_pb2 import FileDescriptorProto

from fastsplat_contract.v1 import fastsplat_pb2

_RELEASED = Path(__file__).with_name("released_wire.binpb")
"""The descriptor of `fastsplat.proto` in the first release."""


def _facts(file: FileDescriptorProto) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Every name with all that its wire format depends on."""
    for message in file.message_type:
        for field in message.field:
            choice = message.oneof_decl[field.oneof_index].name if field.HasField("oneof_index") else ""
            yield (message.name, field.name), (field.number, field.type, field.type_name, field.label, choice)
    for enum in file.enum_type:
        for value in enum.value:
            yield (enum.name, value.name), value.number
    for service in file.service:
        for method in service.method:
            streams = (method.client_streaming, method.server_streaming)
            yield (service.name, method.name), (method.input_type, method.output_type, *streams)


def _reserved(file: FileDescriptorProto) -> Iterator[tuple[str, str, int]]:
    for owner in (*file.message_type, *file.enum_type):
        for name, numbers in zip(owner.reserved_name, owner.reserved_range, strict=True):
            yield owner.name, name, numbers.start


def test_every_name_of_the_first_release_means_what_it_meant_or_is_reserved() -> None:
    released = FileDescriptorProto.FromString(_RELEASED.read_bytes())
    now = FileDescriptorProto()
    fastsplat_pb2.DESCRIPTOR.CopyToProto(now)
    facts, reserved = dict(_facts(now)), set(_reserved(now))
    for name, fact in _facts(released):
        if name in facts:
            assert facts[name] == fact, name
        else:
            number = fact[0] if isinstance(fact, tuple) else fact
            assert (*name, number) in reserved, f"{name} is gone"


def test_the_comparison_sees_a_change() -> None:
    released = FileDescriptorProto.FromString(_RELEASED.read_bytes())
    changed = FileDescriptorProto.FromString(_RELEASED.read_bytes())
    changed.message_type[0].field[0].number += 1
    changed.enum_type[0].value[1].number += 1
    assert len(dict(_facts(released)).items() - dict(_facts(changed)).items()) == 2
