"""The types of the contract taken apart: what travels of each, as both codecs and their tests see it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import MISSING, fields, is_dataclass
from functools import cache
from types import NoneType, UnionType
from typing import Annotated, Any, NamedTuple, Union, get_args, get_origin, get_type_hints

from pydantic.fields import FieldInfo

from fastsplat_contract.codec.wire import Bits64, Carried, OneOf


class Member(NamedTuple):
    """One field of a type."""

    name: str
    kind: Any  # without marks and without None; of many values, the type of one
    many: bool  # whether there are any number of values
    optional: bool  # whether it may be None
    default: bool  # whether it has one
    carried: str  # the protobuf message that has the field; "" for the type's own
    one_of: str  # the protobuf oneof that the field is of; "" for none
    wide: bool  # whether the number has 64 bits in protobuf
    description: str


@cache
def members(kind: Any) -> tuple[Member, ...]:
    """What travels of a dataclass or NamedTuple of the contract, in the order of its fields.

    A class that travels as another one has the members of that one.
    """
    form = getattr(kind, "wire", kind)
    hints = get_type_hints(form, include_extras=True)
    if is_dataclass(form):
        defaults = {f.name: f.default is not MISSING or f.default_factory is not MISSING for f in fields(form)}
    else:
        defaults = {name: name in form._field_defaults for name in hints}
    return tuple(_members(hints, defaults))


def description_of(kind: Any, name: str) -> str:
    """What a type says of one of its fields."""
    return next(member.description for member in members(kind) if member.name == name)


def _members(hints: dict[str, Any], defaults: dict[str, bool]) -> Iterator[Member]:
    for name, default in defaults.items():
        kind, marks = _bare(hints[name])
        if optional := get_origin(kind) in (Union, UnionType):
            (inner,) = (part for part in get_args(kind) if part is not NoneType)
            kind, more = _bare(inner)
            marks += more
        if many := get_origin(kind) in (tuple, frozenset):
            kind, _ = _bare(get_args(kind)[0])
        carried = next((mark.by for mark in marks if isinstance(mark, Carried)), "")
        one_of = next((mark.name for mark in marks if isinstance(mark, OneOf)), "")
        descriptions = (mark.description for mark in marks if isinstance(mark, FieldInfo))
        description = next(filter(None, descriptions), "")
        yield Member(name, kind, many, optional, default, carried, one_of, Bits64() in marks, description)


def _bare(hint: Any) -> tuple[Any, tuple[Any, ...]]:
    """A type, and the marks that it is annotated with."""
    if get_origin(hint) is Annotated:
        kind, *marks = get_args(hint)
        return kind, tuple(marks)
    return hint, ()
