"""multipart/form-data (RFC 7578) as a plain iterator of parts, never more than one chunk in memory."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

from python_multipart.exceptions import FormParserError
from python_multipart.multipart import MultipartParser, parse_options_header

from fastsplat_contract.errors import InvalidInputError, LimitExceededError


@dataclass(frozen=True)
class Part:
    """One part of the form.

    Attributes:
        field: the form field's name.
        filename: the file's name as the client gave it; None for a plain field.
        chunks: the bytes, to be read before the next part is asked for; what is left unread is skipped.
    """

    field: str
    filename: str | None
    chunks: Iterator[bytes]


_END = object()


def read_parts(content_type: str, body: Iterator[bytes], max_parts: int) -> Iterator[Part]:
    """Iterate over the parts of a form while it arrives.

    Args:
        content_type: the request's header, with the boundary.
        body: the request's chunks.
        max_parts: how many parts are accepted.

    Raises:
        InvalidInputError: no multipart form, no boundary, a malformed or truncated form.
        LimitExceededError: more than `max_parts`.
    """
    kind, options = parse_options_header(content_type)
    boundary = options.get(b"boundary", b"")
    if kind != b"multipart/form-data" or not boundary:
        raise InvalidInputError(
            f"the body has type {content_type[:80]!r}",
            field="Content-Type",
            hint="Send multipart/form-data with a boundary, e.g. curl -F images=@photo.jpg",
        )
    events = _Events(boundary, body)
    count = 0
    while (event := events.next()) is not _END:
        if not isinstance(event, dict):
            continue  # left over from a part that nobody read to its end
        count += 1
        if count > max_parts:
            raise LimitExceededError(
                "the form has too many parts",
                field="images",
                limit=f"{max_parts} parts (FASTSPLAT_CAPTURE__MAX_ENTRIES)",
                hint="Send one archive instead of single images.",
            )
        yield _part(event, events)


def _part(headers: dict[str, bytes], events: _Events) -> Part:
    kind, options = parse_options_header(headers.get("content-disposition", b""))
    if kind != b"form-data" or b"name" not in options:
        raise InvalidInputError("a part of the form has no name", field="Content-Disposition")
    try:
        field = options[b"name"].decode()
        filename = options[b"filename"].decode() if b"filename" in options else None
    except UnicodeDecodeError:
        raise InvalidInputError("a name in the form is not UTF-8", field="Content-Disposition") from None
    return Part(field, filename, events.data())


class _Events:
    """The parser's callbacks as a queue: a dict of headers begins a part, bytes are data, None ends a part."""

    def __init__(self, boundary: bytes, body: Iterator[bytes]) -> None:
        self._body = body
        self._queue: deque[dict[str, bytes] | bytes | None] = deque()
        self._finished = False
        self._name = self._value = b""
        self._headers: dict[str, bytes] = {}
        try:
            self._parser = MultipartParser(
                boundary,
                {
                    "on_part_begin": self._headers_begin,
                    "on_header_field": self._header_name,
                    "on_header_value": self._header_value,
                    "on_header_end": self._header_end,
                    "on_headers_finished": lambda: self._queue.append(self._headers),
                    "on_part_data": lambda data, start, end: self._queue.append(bytes(data[start:end])),
                    "on_part_end": lambda: self._queue.append(None),
                    "on_end": self._end,
                },
            )
        except FormParserError as error:
            raise InvalidInputError(f"the form's boundary is unusable: {error}", field="Content-Type") from None

    def next(self) -> object:
        """The next event, or `_END` after the closing boundary."""
        while not self._queue:
            if self._finished:
                return _END
            chunk = next(self._body, None)
            if chunk is None:
                raise InvalidInputError(
                    "the form ends before its closing boundary", field="body", hint="Send the whole form again."
                )
            try:
                self._parser.write(chunk)
            except FormParserError as error:
                raise InvalidInputError(f"the form is malformed: {error}", field="body") from None
        return self._queue.popleft()

    def data(self) -> Iterator[bytes]:
        """The bytes up to the end of the part that has just begun."""
        while isinstance(event := self.next(), bytes):
            yield event

    def _headers_begin(self) -> None:
        self._headers, self._name, self._value = {}, b"", b""

    def _header_name(self, data: bytes, start: int, end: int) -> None:
        self._name += data[start:end]

    def _header_value(self, data: bytes, start: int, end: int) -> None:
        self._value += data[start:end]

    def _header_end(self) -> None:
        self._headers[self._name.decode("latin-1").lower()] = self._value
        self._name = self._value = b""

    def _end(self) -> None:
        self._finished = True
