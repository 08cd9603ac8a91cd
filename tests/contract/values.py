"""Random values of every type of the contract, drawn by its annotations and its bounds."""

from __future__ import annotations

import os
from collections.abc import Mapping
from datetime import datetime, timezone
from functools import cache
from typing import Any, Literal, get_args, get_origin

from hypothesis import strategies as st

from fastsplat_contract.codec.json_codec import json_schema_of
from fastsplat_contract.codec.members import Member, members
from fastsplat_contract.codec.proto_codec import message_class
from fastsplat_contract.geometry.poses import Quaternion
from fastsplat_contract.messages.queries import QueryOut
from fastsplat_contract.server.problems import Problem
from fastsplat_contract.server.server_info import ServerInfo

EXAMPLES = int(os.environ.get("CONTRACT_EXAMPLES", "15"))
"""Random values of each type; fewer where the same tests run on several interpreters."""

JSON_ONLY = {Problem, QueryOut, ServerInfo}  # what has no message of its own

_TEXT = st.text(st.characters(exclude_categories=["Cs"]), max_size=8)
_FLOAT = st.floats(allow_nan=False, allow_infinity=False)
_JSON = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**53), 2**53) | _FLOAT | _TEXT,
    lambda inner: st.lists(inner, max_size=2) | st.dictionaries(_TEXT, inner, max_size=2),
    max_leaves=4,
)
# Of length 1 to the last digit, so that normalising changes nothing; w > 0, as the same rotation has two.
_UNIT = [Quaternion(0.0, 0.0, 0.0, 1.0), Quaternion(0.5, -0.5, 0.5, 0.5), Quaternion(0.6, 0.0, 0.0, 0.8)]


@cache
def values_of(kind: Any) -> st.SearchStrategy[Any]:
    if kind is Quaternion:
        return st.sampled_from(_UNIT)
    if hasattr(kind, "wire"):
        return values_of(kind.wire).map(kind.from_wire)
    fields = {} if kind in JSON_ONLY else message_class(kind).DESCRIPTOR.fields_by_name
    bounds = _bounds(kind)
    drawn = {m.name: _member(m, fields.get(m.name), bounds.get(m.name, {})) for m in members(kind)}
    return st.fixed_dictionaries(drawn).map(lambda values: kind(**_one_of_each(values, fields)))


@cache
def _bounds(kind: Any) -> Mapping[str, Any]:
    schema = json_schema_of(kind)
    properties: Mapping[str, Any] = (schema["$defs"][kind.__name__] if "$ref" in schema else schema)["properties"]
    return properties


def _one_of_each(values: dict[str, Any], fields: Mapping[str, Any]) -> dict[str, Any]:
    """Of the fields of one oneof, at most one."""
    seen: set[str] = set()
    for name in values:
        group = fields[name].containing_oneof if name in fields else None
        if group is not None and values[name] is not None:
            if group.name in seen:
                values = {**values, name: None}
            seen.add(group.name)
    return values


def _member(member: Member, field: Any, bounds: Mapping[str, Any]) -> st.SearchStrategy[Any]:
    values = _value(member.kind, field, bounds)
    if member.many:
        least, most = bounds.get("minItems", 0), min(bounds.get("maxItems", 3), 3)
        values = st.lists(values, min_size=least, max_size=most).map(frozenset if member.name == "outputs" else tuple)
    if not member.optional:
        return values
    empty_is_none = (field is not None and not field.has_presence) or member.carried
    return st.none() | (values.filter(bool) if empty_is_none else values)


def _value(kind: Any, field: Any, bounds: Mapping[str, Any]) -> st.SearchStrategy[Any]:
    branches = [choice for choice in bounds.get("anyOf", ()) if choice.get("type") != "null"]
    bounds = {**bounds, **(branches[0] if branches else {})}
    if kind is bool:
        return st.booleans()
    if kind is int:
        bits = 31 if field is None or field.cpp_type == field.CPPTYPE_INT32 else 53
        low, high = bounds.get("minimum", -(2**bits)), bounds.get("exclusiveMaximum", 2**bits) - 1
        return st.integers(low, bounds.get("maximum", high))
    if kind is float:
        return st.floats(
            bounds.get("minimum", bounds.get("exclusiveMinimum")),
            bounds.get("maximum", bounds.get("exclusiveMaximum")),
            exclude_min="exclusiveMinimum" in bounds,
            exclude_max="exclusiveMaximum" in bounds,
            allow_nan=False,
            allow_infinity=False,
        )
    if kind is str:
        if "pattern" in bounds:
            return st.from_regex(bounds["pattern"].replace("$", r"\Z"))
        return _TEXT.filter(lambda text: len(text) >= bounds.get("minLength", 0))
    if kind is bytes:
        return st.binary(max_size=20)
    if kind is datetime:
        return st.datetimes(datetime(1970, 1, 1), datetime(2200, 1, 1), timezones=st.just(timezone.utc))
    if get_origin(kind) is Literal:
        return st.sampled_from(get_args(kind))
    if get_origin(kind) is not None:
        value = get_args(kind)[1]
        return st.dictionaries(_TEXT, _JSON if value is Any else _value(value, None, {}), max_size=3)
    return values_of(kind)
