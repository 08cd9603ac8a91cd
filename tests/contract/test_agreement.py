"""The OpenAPI document says the same of every field as the type: name, presence, type, description."""

from __future__ import annotations

import json
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import pytest

from fastsplat_contract.codec.members import Member, members
from tests.contract.catalog import TYPES

_ROOT = Path(__file__).resolve().parents[2]
_SCHEMAS = json.loads((_ROOT / "api/rest/openapi.json").read_text())["components"]["schemas"]
_SCALARS: Mapping[Any, str] = {
    bool: "boolean",
    int: "integer",
    float: "number",
    str: "string",
    bytes: "string",
    datetime: "string",
}


def test_every_schema_is_a_type() -> None:
    assert set(_SCHEMAS) <= set(TYPES)


@pytest.mark.parametrize("name", _SCHEMAS)
def test_json_has_the_same_fields(name: str) -> None:
    schema = _SCHEMAS[name]
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
    (schema,) = (choice for choice in choices if choice.get("type") != "null")
    return _json_kind(schema), len(choices) > 1


def _json_kind(schema: Mapping[str, Any]) -> Any:
    if "$ref" in schema:
        return schema["$ref"].rpartition("/")[2]
    if "enum" in schema:
        return tuple(schema["enum"])
    if schema["type"] == "array":
        return [_json_kind(schema["items"])]
    return "date-time" if schema.get("format") == "date-time" else schema["type"]


def _expected_json(member: Member) -> tuple[Any, bool]:
    kind = member.kind
    if get_origin(kind) is Literal:
        json_kind: Any = get_args(kind)
    elif kind is datetime:
        json_kind = "date-time"
    elif get_origin(kind) is not None:
        json_kind = "object"
    else:
        json_kind = _SCALARS[kind] if kind in _SCALARS else getattr(kind, "wire", kind).__name__
    return ([json_kind] if member.many else json_kind), member.optional
