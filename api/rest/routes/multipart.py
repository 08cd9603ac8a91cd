"""Streaming parser of multipart/form-data (RFC 7578) that buffers no content."""

from __future__ import annotations

from typing import Protocol

from python_multipart.exceptions import FormParserError
from python_multipart.multipart import MultipartParser, parse_options_header

from fastsplat_contract.errors import InvalidInputError, LimitExceededError

_MAX_EPILOGUE_BYTES = 2**20


class PartReceiver(Protocol):
    """Receiver of a form's parts, one after the other."""

    def begin_part(self, field: str, filename: str | None) -> None:
        """Begins a part; `filename` is the client's, None for a plain field."""

    def part_data(self, data: bytes) -> None:
        """Takes more data of the part."""

    def end_part(self) -> None:
        """Ends the part."""


class FormParser:
    """Parses a form from pieces of any size; the receiver's exceptions pass through `write`.

    Raises:
        InvalidInputError: the type is not multipart/form-data, or its boundary is missing or unusable.
    """

    def __init__(self, content_type: str, receiver: PartReceiver, max_parts: int) -> None:
        kind, options = parse_options_header(content_type)
        boundary = options.get(b"boundary", b"")
        if kind != b"multipart/form-data" or not boundary:
            raise InvalidInputError(
                f"the body has type {content_type[:80]!r}",
                field="Content-Type",
                hint="Send multipart/form-data with a boundary, e.g. curl -F images=@photo.jpg",
            )
        self._receiver = receiver
        self._max_parts = max_parts
        self._parts = 0
        self._epilogue = 0
        self._complete = False
        self._name = self._value = b""
        self._headers: dict[str, bytes] = {}
        try:
            self._parser = MultipartParser(
                boundary,
                {
                    "on_part_begin": self._begin_headers,
                    "on_header_field": self._header_name,
                    "on_header_value": self._header_value,
                    "on_header_end": self._end_header,
                    "on_headers_finished": self._begin_part,
                    "on_part_data": lambda data, start, end: receiver.part_data(bytes(data[start:end])),
                    "on_part_end": receiver.end_part,
                    "on_end": self._end,
                },
            )
        except FormParserError as error:
            raise InvalidInputError(f"the form's boundary is unusable: {error}", field="Content-Type") from None

    def write(self, data: bytes) -> None:
        """Parses the next piece of the body.

        Raises:
            InvalidInputError: the form is malformed or continues far beyond its end.
            LimitExceededError: it has more than `max_parts` parts.
        """
        if self._complete:  # RFC 2046 allows an epilogue
            self._epilogue += len(data)
            if self._epilogue > _MAX_EPILOGUE_BYTES:
                raise InvalidInputError("the form goes on behind its closing boundary", field="body")
            return
        try:
            self._parser.write(data)
        except FormParserError as error:
            raise InvalidInputError(f"the form is malformed: {error}", field="body") from None

    def finish(self) -> None:
        """Raises `InvalidInputError` if the closing boundary is missing; called at the body's end."""
        if not self._complete:
            raise InvalidInputError(
                "the form ends before its closing boundary", field="body", hint="Send the whole form again."
            )

    def _begin_headers(self) -> None:
        self._headers, self._name, self._value = {}, b"", b""

    def _header_name(self, data: bytes, start: int, end: int) -> None:
        self._name += data[start:end]

    def _header_value(self, data: bytes, start: int, end: int) -> None:
        self._value += data[start:end]

    def _end_header(self) -> None:
        self._headers[self._name.decode("latin-1").lower()] = self._value
        self._name = self._value = b""

    def _begin_part(self) -> None:
        self._parts += 1
        if self._parts > self._max_parts:
            raise LimitExceededError(
                "the form has too many parts",
                field="images",
                limit=f"{self._max_parts} parts",
                hint="Send one archive instead of single images.",
            )
        kind, options = parse_options_header(self._headers.get("content-disposition", b""))
        if kind != b"form-data" or b"name" not in options:
            raise InvalidInputError("a part of the form has no name", field="Content-Disposition")
        try:
            field = options[b"name"].decode()
            filename = options[b"filename"].decode() if b"filename" in options else None
        except UnicodeDecodeError:
            raise InvalidInputError("a name in the form is not UTF-8", field="Content-Disposition") from None
        self._receiver.begin_part(field, filename)

    def _end(self) -> None:
        self._complete = True
