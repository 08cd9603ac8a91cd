"""What the contract's types say about themselves, on their fields: documentation, bounds, presence and names.

A field's annotation is all that there is to know about it. `int | None` may be absent (null in JSON), `Field` has its
description and its bounds, and the marks below say what the JSON codec or the protobuf codec must know beside that.
"""

from __future__ import annotations

import base64
import inspect
import json
from collections.abc import Callable
from datetime import datetime
from typing import Annotated, Any, ClassVar, NamedTuple, TypeVar, cast, get_type_hints

from pydantic import (
    BeforeValidator,
    ConfigDict,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    PlainSerializer,
    TypeAdapter,
)
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from fastsplat_contract.errors import InvalidInputError

T = TypeVar("T")
JsonSchema = dict[str, Any]


class Message:
    """Base of the dataclasses that travel, as JSON objects and as protobuf messages: no silent conversion, no NaN."""

    proto: ClassVar[str] = ""
    """The protobuf message's name where it is not the class's own."""
    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(strict=True, allow_inf_nan=False)
    _schema: ClassVar[CoreSchema | None]

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        if "_schema" not in vars(cls):  # made once: it stands in many routes' requests and answers
            cls._schema = None
            cls._schema = TypeAdapter(cls).core_schema
        if cls._schema is not None:
            return cls._schema
        schema = handler(source)
        # The values are strict; the object itself comes as a dict.
        cast(dict[str, Any], handler.resolve_ref_schema(schema))["strict"] = False
        return schema

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchema:
        return _described(cls, schema, handler)


class Request(Message):
    """Base of what a client sends: a field that is unknown is refused."""

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(strict=True, allow_inf_nan=False, extra="forbid")


class Response(Message):
    """Base of what a server sends: every field is there, null where it is absent."""

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(
        strict=True, allow_inf_nan=False, json_schema_serialization_defaults_required=True
    )


def travels(*, request: bool, proto: str = "") -> Callable[[type[T]], type[T]]:
    """A class decorator: a NamedTuple travels as an object, as a `Request` or a `Response` does."""

    def decorate(cls: Any) -> Any:
        def schema_of(source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
            hints = get_type_hints(cls, include_extras=True)
            fields = {name: core_schema.typed_dict_field(handler.generate_schema(hint)) for name, hint in hints.items()}
            inner = core_schema.typed_dict_schema(
                fields,
                extra_behavior="forbid" if request else "ignore",
                config={"strict": True, "allow_inf_nan": False},
            )
            return core_schema.no_info_after_validator_function(
                lambda values: cls(**values),
                inner,
                ref=f"{cls.__module__}.{cls.__qualname__}:{id(cls)}",
                serialization=core_schema.plain_serializer_function_ser_schema(
                    lambda value: dict(zip(hints, value, strict=True)),  # of a plain tuple, too
                    return_schema=inner,
                ),
            )

        cls.proto, cls.as_named = proto, lambda value: value if isinstance(value, cls) else cls(*value)
        cls.__get_pydantic_core_schema__ = schema_of
        cls.__get_pydantic_json_schema__ = lambda schema, handler: _described(cls, schema, handler)
        return cls

    return decorate


def _described(cls: type, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchema:
    json_schema = handler(schema)
    handler.resolve_ref_schema(json_schema).update(title=cls.__name__, description=inspect.cleandoc(cls.__doc__ or ""))
    return json_schema


class _List:
    """A tuple or set is an array in JSON, whatever its order and however often a value is there."""

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        schema = handler(source)
        return cast(CoreSchema, {**schema, "strict": False})

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchema:
        return {name: value for name, value in handler(schema).items() if name != "uniqueItems"}


Many = Annotated[tuple[T, ...], _List()]
"""Any number of values."""

Some = Annotated[frozenset[T], _List(), PlainSerializer(sorted, return_type=list[T])]
"""Any of a few values."""


def _from_base64(value: Any) -> bytes:
    try:
        return value if isinstance(value, bytes) else base64.b64decode(value, validate=True)
    except (TypeError, ValueError):
        raise PydanticCustomError("base64", "Input should be base64") from None


Base64 = Annotated[
    bytes,
    BeforeValidator(_from_base64, json_schema_input_type=str),
    PlainSerializer(lambda data: base64.b64encode(data).decode("ascii"), return_type=str),
]
"""Bytes are base64 (RFC 4648, section 4) in JSON."""


def _from_rfc_3339(value: Any) -> Any:
    return _TIMES.validate_json(json.dumps(value)) if isinstance(value, str) else value


_TIMES = TypeAdapter(datetime)
RFC_3339 = BeforeValidator(_from_rfc_3339)
"""Of a time in a request: its text is read, as a strict reader of Python's values would not."""


class Carried(NamedTuple):
    """In protobuf the field stands in another message, which carries this one."""

    by: str


class OneOf(NamedTuple):
    """In protobuf the field is one of a oneof: of the fields of one name, a message has one at most."""

    name: str


class Bits64(NamedTuple):
    """In protobuf the number has 64 bits; others have 32."""


Int64 = Annotated[int, Bits64()]
"""A number that may pass 2^31; in protobuf it has 64 bits."""


def checked(check: Callable[[T], T]) -> Callable[[T], T]:
    """A validator of pydantic that refuses what `check` refuses, with its limit and its hint."""

    def validate(value: T) -> T:
        try:
            return check(value)
        except InvalidInputError as error:
            parts = {"message": error.message, "limit": error.limit, "hint": error.hint}
            raise PydanticCustomError("contract", "{message}", parts) from None

    return validate
