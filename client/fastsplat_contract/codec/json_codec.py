"""The contract's types as JSON and back: pydantic, driven by the types. Server and client use nothing else."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import Any, TypeVar

from pydantic import TypeAdapter, ValidationError

from fastsplat_contract.errors import InvalidInputError

T = TypeVar("T")

_adapter: Callable[[Any], TypeAdapter[Any]] = cache(TypeAdapter)

_IN_JSONS_WORDS = {
    **dict.fromkeys(("tuple_type", "frozen_set_type"), "Input should be a valid list"),
    **dict.fromkeys(("dataclass_type", "dict_type"), "Input should be an object"),
    "unexpected_keyword_argument": "Extra inputs are not permitted",
}


def to_json(value: Any) -> bytes:
    """A value of the contract as JSON, UTF-8."""
    return _adapter(type(value)).dump_json(value)


def from_json(kind: type[T], content: bytes | str) -> T:
    """Reads what `to_json` wrote, ignoring fields of later releases; `InvalidInputError` names the field."""
    try:
        value: T = _adapter(kind).validate_json(content, extra="ignore")
    except ValidationError as error:
        raise invalid_input(error.errors(include_url=False)) from None
    return value


def to_plain(value: Any) -> Any:
    """A value of the contract as dicts, lists, texts and numbers that `json.dumps` takes."""
    return _adapter(type(value)).dump_python(value, mode="json")


def from_plain(kind: type[T], plain: Any, path: str = "") -> T:
    """Reads what `to_plain` made, strictly; `InvalidInputError` names the field, which lies in `path`."""
    try:
        value: T = _adapter(kind).validate_python(plain)
    except ValidationError as error:
        refused = invalid_input(error.errors(include_url=False))
        raise (refused.within(path) if path else refused) from None
    return value


def invalid_input(errors: Sequence[Mapping[str, Any]], skip: int = 0) -> InvalidInputError:
    """The first of pydantic's errors; `skip` leaves out the first parts of its location."""
    first = errors[0]
    said = first["ctx"] if first["type"] == "contract" else {}
    message = _IN_JSONS_WORDS.get(first["type"], first["msg"])
    return InvalidInputError(
        message, field=path_of(first["loc"][skip:]), limit=said.get("limit", ""), hint=said.get("hint", "")
    )


def json_schema_of(kind: type) -> dict[str, Any]:
    """The JSON schema of a type."""
    return _adapter(kind).json_schema()


def path_of(location: Sequence[str | int]) -> str:
    """("cameras", 0, "position") as cameras[0].position."""
    path = ""
    for part in location:
        path += f"[{part}]" if isinstance(part, int) else f".{part}" if path else part
    return path
