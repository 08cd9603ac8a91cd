"""Unreadable rows: typed errors if requested, omitted from lists."""

from __future__ import annotations

import json
import logging
import re
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache, wraps
from types import UnionType
from typing import TYPE_CHECKING, Any, Concatenate, Literal, ParamSpec, TypeVar, Union

from fastsplat_contract.errors import ArtefactError, FastSplatError, InvalidInputError, SceneFileError

if TYPE_CHECKING:
    from sqlalchemy import Connection, RowMapping, Select

P = ParamSpec("P")
R = TypeVar("R")
S = TypeVar("S")
T = TypeVar("T")
_HINT = "Run: fastsplat doctor. Then restore a backup of the database, or delete it."
_END_OF_TIME = 253_402_300_800.0  # the year 10000, where dates end
_NAME = re.compile(r"[^./\\\0][^/\\\0]*")

_log = logging.getLogger(__name__)


def require(what: str, **columns: bool) -> None:
    """Checks that all columns of a row ("scene 5f", "operation 7a") are readable.

    Raises:
        SceneFileError, ArtefactError: one is not, of a scene or version, or of anything else.
    """
    unreadable = [name for name, readable in columns.items() if not readable]
    if unreadable:
        raise _damaged(what, f"{', '.join(unreadable)} cannot be read")


def require_fields(what: str, record: Any, **columns: bool) -> None:
    """Checks a dataclass as `require`: `columns`, and whether other fields fit their types, where floats are times."""
    fields = {name: fits(getattr(record, name)) for name, fits in _checks(record.__class__).items()}
    require(what, **{**fields, **columns})


@cache
def _checks(record: Any) -> Mapping[str, Callable[[object], bool]]:
    return {name: _check(hint) for name, hint in typing.get_type_hints(record).items()}


def _check(hint: Any) -> Callable[[object], bool]:
    origin, arguments = typing.get_origin(hint) or hint, typing.get_args(hint)
    if origin is Literal:
        return lambda value: value in arguments
    if origin in (Union, UnionType):
        first, second = map(_check, arguments)
        return lambda value: first(value) or second(value)
    if origin is Sequence and typing.get_origin(arguments[0]) is Mapping:
        return are_objects
    return is_time if hint is float else lambda value: isinstance(value, origin)


def decodes(kind: str) -> Callable[[Callable[Concatenate[R, P], T]], Callable[Concatenate[R, P], T]]:
    """Decorates a decoder of a record: its errors become those of `require` for that kind."""

    def decorator(read: Callable[Concatenate[R, P], T]) -> Callable[Concatenate[R, P], T]:
        @wraps(read)
        def decoding(record: R, /, *args: P.args, **kwargs: P.kwargs) -> T:
            try:
                return read(record, *args, **kwargs)
            except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError, InvalidInputError) as error:
                name = getattr(record, "id", None) or getattr(record, kind)
                raise _damaged(f"{kind} {name}", f"{type(error).__name__}: {str(error)[:100]}") from error

        return decoding

    return decorator


def each_readable(items: Iterable[S], read: Callable[[S], T]) -> list[T]:
    """Applies `read` to each item; leaves out and logs those whose rows are damaged."""
    results: list[T] = []
    for item in items:
        try:
            results.append(read(item))
        except (SceneFileError, ArtefactError) as error:
            _log.warning("left out: %s", error.message)
    return results


def first_readable(
    connection: Connection, query: Select[Any], limit: int, read: Callable[[RowMapping], T]
) -> Sequence[T]:
    """Reads the first `limit` readable rows of a query."""
    results: list[T] = []
    start = 0
    while len(results) < limit:
        rows = connection.execute(query.limit(limit - len(results)).offset(start)).mappings().all()
        if not rows:
            break
        results += each_readable(rows, read)
        start += len(rows)
    return results


def read_json(content: str | bytes) -> Any:
    """Decodes a JSON column; returns malformed content unchanged, for `require` to reject."""
    try:
        return json.loads(content)
    except (ValueError, RecursionError):
        return content


def is_time(value: object) -> bool:
    """True for seconds since 1970 that are a date before the year 10000."""
    return isinstance(value, int | float) and 0 <= value < _END_OF_TIME


def is_name(value: object) -> bool:
    """True for a folder name."""
    return isinstance(value, str) and _NAME.fullmatch(value) is not None


def are_objects(value: object, *keys: str) -> bool:
    """True for a list of JSON objects that have these keys."""
    return isinstance(value, Sequence) and all(isinstance(row, Mapping) and row.keys() >= set(keys) for row in value)


def is_object(value: object) -> bool:
    """True for a JSON object."""
    return isinstance(value, Mapping)


def _damaged(what: str, why: str) -> FastSplatError:
    kind = what.partition(" ")[0]
    error = SceneFileError if kind in ("scene", "version") else ArtefactError
    return error(f"the row of {what} is damaged: {why}", field=kind, hint=_HINT)
