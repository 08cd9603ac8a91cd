"""The streaming form parser."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fastsplat.api.rest.routes.multipart import FormParser
from fastsplat_contract.errors import InvalidInputError, LimitExceededError

_TYPE = "multipart/form-data; boundary=--edge"
_FILES = (b"\r\n----edge", b"", b"----edge--\r\n", b"plain\r\n\r\nbytes" * 50)


def _form() -> bytes:
    body = b'----edge\r\nContent-Disposition: form-data; name="labels"\r\n\r\nmug, \xc3\xbc\r\n'
    for number, data in enumerate(_FILES):
        head = f'Content-Disposition: form-data; name="images"; filename="a/{number}.jpg"\r\nContent-Type: image/jpeg'
        # A boundary may not occur in a part, so the data's own edges get a letter in front.
        body += b"----edge\r\n" + head.encode() + b"\r\n\r\n" + data.replace(b"----edge", b"x---edge") + b"\r\n"
    return body + b"----edge--\r\n"


def _split(body: bytes, cuts: list[int]) -> Iterator[bytes]:
    places = sorted({0, len(body), *(cut % len(body) for cut in cuts)})
    for start, stop in pairwise(places):
        yield body[start:stop]


class _Parts:
    """All parts of a form, in memory."""

    def __init__(self) -> None:
        self.parts: list[tuple[str, str | None, bytes]] = []
        self._head: tuple[str, str | None] = ("", None)
        self._data = b""

    def begin_part(self, field: str, filename: str | None) -> None:
        self._head, self._data = (field, filename), b""

    def part_data(self, data: bytes) -> None:
        self._data += data

    def end_part(self) -> None:
        self.parts.append((*self._head, self._data))


def _parse(content_type: str, body: Iterable[bytes], max_parts: int) -> list[tuple[str, str | None, bytes]]:
    received = _Parts()
    parser = FormParser(content_type, received, max_parts)
    for chunk in body:
        parser.write(chunk)
    parser.finish()
    return received.parts


@given(st.lists(st.integers(0, 10_000), max_size=40))
def test_any_split_of_the_stream_gives_the_same_parts(cuts: list[int]) -> None:
    parts = _parse(_TYPE, _split(_form(), cuts), 10)
    files = [("images", f"a/{n}.jpg", data.replace(b"----edge", b"x---edge")) for n, data in enumerate(_FILES)]
    assert parts == [("labels", None, "mug, ü".encode()), *files]


def test_a_little_may_follow_the_form_and_means_nothing() -> None:
    assert len(_parse(_TYPE, [_form(), b"x" * 1_000, b"----edge\r\n"], 10)) == 5
    with pytest.raises(InvalidInputError, match="behind its closing boundary"):
        _parse(_TYPE, [_form(), *[bytes(2**16)] * 17], 10)


@pytest.mark.parametrize("end", [1, 20, 60, 120, 300, -30, -4])
def test_a_form_cut_anywhere_is_never_taken_for_whole(end: int) -> None:
    with pytest.raises(InvalidInputError, match="ends before"):
        _parse(_TYPE, [_form()[:end]], 10)


@pytest.mark.parametrize(
    "content_type", ["", "application/json", "multipart/form-data", "multipart/form-data; boundary=" + "x" * 5000]
)
def test_other_bodies_are_refused(content_type: str) -> None:
    with pytest.raises(InvalidInputError) as caught:
        _parse(content_type, [_form()], 10)
    assert caught.value.field == "Content-Type"


def test_garbage_is_refused() -> None:
    with pytest.raises(InvalidInputError):
        _parse(_TYPE, [b"----edge\r\nno header at all\x00\r\n\r\n"], 10)


def test_the_number_of_parts_is_bounded() -> None:
    with pytest.raises(LimitExceededError, match="too many parts"):
        _parse(_TYPE, [_form()], 4)
