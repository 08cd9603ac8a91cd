"""Server-sent events as they come over the wire (WHATWG HTML, section 9.2.6), as far as this service uses them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple


class Event(NamedTuple):
    """One event; `id` continues after it."""

    id: str
    data: str
    kind: str = "message"


def events_of(lines: Iterable[str]) -> Iterator[Event]:
    """The whole events in a stream's lines; one that the end cuts off is none."""
    name, kind, data = "", "", list[str]()
    for line in lines:
        if not line:
            if data:
                yield Event(name, "\n".join(data), kind or "message")
            kind, data = "", []
        elif not line.startswith(":"):
            field, _, value = line.partition(":")
            value = value.removeprefix(" ")
            if field == "data":
                data.append(value)
            elif field == "id":
                name = value
            elif field == "event":
                kind = value
