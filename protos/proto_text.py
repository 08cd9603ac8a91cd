"""Writes the .proto from the contract: its service from the table of calls, its messages and enums from the types."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import re
import textwrap
from collections.abc import Iterable, Iterator, Mapping
from datetime import datetime
from functools import cache
from types import NoneType
from typing import Any, Literal, get_args, get_origin

import fastsplat_contract
from fastsplat_contract.call import Call
from fastsplat_contract.calls import CALLS
from fastsplat_contract.codec.members import Member, members
from fastsplat_contract.masks import ViewMaskPiece
from protos.registry import Registry

_WIDTH = 120
_SCALARS = {bool: "bool", int: "int32", float: "double", str: "string", bytes: "bytes"}
_MESSAGES = {datetime: "google.protobuf.Timestamp", NoneType: "google.protobuf.Empty"}
_STRINGS = {"Lens", "ModelRole", "ModelState", "Movers", "PresetName", "Privacy", "QuotaKind", "UpAxis"}
"""Choices that travel as text, as they have since they are there; all others are enums."""


def proto_text(template: str, registry: Registry) -> str:
    """`template` with the service and the messages in their places; what is new gets its number from `registry`."""
    by_hand = set(re.findall(r"^message (\w+)", template, re.MULTILINE))
    roots = [kind for call in CALLS for kind in (call.request, call.response)]
    kinds: dict[str, list[Any]] = {}
    for kind in _reached([*roots, ViewMaskPiece], set()):
        kinds.setdefault(_name_of(kind), []).append(kind)
    blocks = [
        _enum(kinds[name][0], name, registry) if get_origin(kinds[name][0]) is Literal else _message(name, of, registry)
        for name, of in kinds.items()
        if name not in by_hand
    ]
    service = "service SceneService {\n" + "".join(map(_rpc, CALLS)) + "}"
    return template.replace("@service@", service).replace("@messages@", "\n\n".join(blocks))


def _reached(kinds: Iterable[Any], seen: set[Any]) -> Iterator[Any]:
    """All messages and enums that are part of some types, each once, before what is only part of it."""
    for kind in kinds:
        form = getattr(kind, "wire", kind)
        if get_origin(form) is Literal:
            if form not in seen and _choice_name(form) not in _STRINGS:
                seen.add(form)
                yield form
        elif get_origin(form) is None and form not in _SCALARS | _MESSAGES and form not in seen:
            seen.add(form)
            yield form
            yield from _reached([member.kind for member in members(form)], seen)


def _name_of(kind: Any) -> str:
    return _choice_name(kind) if get_origin(kind) is Literal else kind.proto or kind.__name__


@cache
def _choice_name(choice: Any) -> str:
    """What the contract calls a Literal."""
    modules = (module.name for module in pkgutil.walk_packages(fastsplat_contract.__path__, "fastsplat_contract."))
    named = {
        name
        for module in modules
        if ".v1" not in module
        for name, value in vars(importlib.import_module(module)).items()
        if get_origin(value) is Literal and value == choice
    }
    if len(named) != 1:
        raise SystemExit(f"the contract must have one name for {choice}, not {sorted(named)}")
    return named.pop()


def _rpc(call: Call[Any, Any]) -> str:
    request = f"stream {call.pieces_in}" if call.pieces_in else _message_name(call.request)
    answered = f"stream {call.pieces_out}" if call.pieces_out else _message_name(call.response)
    end = " {\n    option deprecated = true;\n  }" if call.deprecated else ";"
    return _comment(call.said, "  ") + f"  rpc {call.rpc}({request}) returns ({answered}){end}\n"


def _message_name(kind: Any) -> str:
    return _MESSAGES[kind] if kind in _MESSAGES else _name_of(kind)


def _message(name: str, kinds: list[Any], registry: Registry) -> str:
    """A message of the types that travel as it: one, or some of which one has the fields of the others and more."""
    widest = max(kinds, key=lambda kind: len(members(kind)))
    body = {member.name: member for member in members(widest) if not member.carried}
    assert all(member.name in body for kind in kinds for member in members(kind) if not member.carried), name
    described = next((kind for kind in kinds if kind.__name__ == name), widest)
    text = _comment(inspect.cleandoc(described.__doc__ or ""), "") + f"message {name} {{\n"
    numbers = registry.numbers(name, body)
    text += "".join(_reserved(registry.retired(name, body)))
    begun: set[str] = set()
    for field in numbers:
        choice = body[field].one_of
        if not choice:
            text += _line(f"{_label(body[field])}{_type(body[field])} {field} = {numbers[field]};", body[field], "  ")
        elif choice not in begun:
            begun.add(choice)
            of_choice = [member for member in map(body.__getitem__, numbers) if member.one_of == choice]
            lines = (_line(f"{_type(part)} {part.name} = {numbers[part.name]};", part, "    ") for part in of_choice)
            text += f"  oneof {choice} {{\n{''.join(lines)}  }}\n"
    return text + "}"


def _enum(choice: Any, name: str, registry: Registry) -> str:
    prefix = re.sub(r"(?<=.)(?=[A-Z])", "_", name).upper()
    numbers = registry.numbers(name, get_args(choice))
    retired = registry.retired(name, get_args(choice)).items()
    lines = [f"  {prefix}_UNSPECIFIED = 0;\n"]
    lines += _reserved({f"{prefix}_{value.upper()}": number for value, number in retired})
    lines += [f"  {prefix}_{value.upper()} = {number};\n" for value, number in numbers.items()]
    return f"enum {name} {{\n{''.join(lines)}}}"


def _reserved(retired: Mapping[str, int]) -> Iterator[str]:
    for name, number in retired.items():
        yield f'  reserved {number};\n  reserved "{name}";\n'


def _label(member: Member) -> str:
    if member.many:
        return "repeated "
    is_message = member.kind in _MESSAGES or not (member.kind in _SCALARS or get_origin(member.kind) is Literal)
    return "optional " if member.optional and not is_message else ""


def _type(member: Member) -> str:
    kind = getattr(member.kind, "wire", member.kind)
    if kind in _SCALARS:
        return "int64" if member.wide else _SCALARS[kind]
    if kind in _MESSAGES:
        return _MESSAGES[kind]
    if get_origin(kind) is Literal:
        name = _choice_name(kind)
        return "string" if name in _STRINGS else name
    if get_origin(kind) is not None:
        value = get_args(kind)[1]
        return "google.protobuf.Struct" if value is Any else f"map<string, {_SCALARS[value]}>"
    return _name_of(kind)


def _line(declared: str, member: Member, indent: str) -> str:
    """A field with its description: behind it where there is room, else above."""
    line = f"{indent}{declared}  // {member.description}"
    if not member.description:
        return f"{indent}{declared}\n"
    return f"{line}\n" if len(line) <= _WIDTH else f"{_comment(member.description, indent)}{indent}{declared}\n"


def _comment(text: str, indent: str) -> str:
    lines = textwrap.wrap(" ".join(text.split()), _WIDTH - len(indent) - 3, break_long_words=False)
    return "".join(f"{indent}// {line}\n" for line in lines)
