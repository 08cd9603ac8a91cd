"""Parser of server-sent events (WHATWG HTML, section 9.2.6), as far as the service uses them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple


class Event(NamedTuple):
    """One event; its `id` resumes the stream after it."""

    id: str
    data: str
    kind: str = "message"


def events_of(lines: Iterable[str]) -> Iterator[Event]:
    """Yields the complete events of a stream's lines."""
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
