"""The streaming form parser."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fastsplat.api.rest.multipart import read_parts
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


@given(st.lists(st.integers(0, 10_000), max_size=40))
def test_any_split_of_the_stream_gives_the_same_parts(cuts: list[int]) -> None:
    parts = [(p.field, p.filename, b"".join(p.chunks)) for p in read_parts(_TYPE, _split(_form(), cuts), 10)]
    files = [("images", f"a/{n}.jpg", data.replace(b"----edge", b"x---edge")) for n, data in enumerate(_FILES)]
    assert parts == [("labels", None, "mug, ü".encode()), *files]


def test_unread_parts_are_skipped() -> None:
    assert [part.filename for part in read_parts(_TYPE, iter([_form()]), 10)] == [
        None, "a/0.jpg", "a/1.jpg", "a/2.jpg", "a/3.jpg"
    ]  # fmt: skip


@pytest.mark.parametrize("end", [1, 20, 60, 120, 300, -30, -4])
def test_a_form_cut_anywhere_is_never_taken_for_whole(end: int) -> None:
    parts = read_parts(_TYPE, iter([_form()[:end]]), 10)
    with pytest.raises(InvalidInputError, match="ends before"):
        [b"".join(part.chunks) for part in parts]


@pytest.mark.parametrize(
    "content_type", ["", "application/json", "multipart/form-data", "multipart/form-data; boundary=" + "x" * 5000]
)
def test_other_bodies_are_refused(content_type: str) -> None:
    with pytest.raises(InvalidInputError) as caught:
        list(read_parts(content_type, iter([_form()]), 10))
    assert caught.value.field == "Content-Type"


def test_garbage_is_refused() -> None:
    with pytest.raises(InvalidInputError):
        list(read_parts(_TYPE, iter([b"----edge\r\nno header at all\x00\r\n\r\n"]), 10))


def test_the_number_of_parts_is_bounded() -> None:
    with pytest.raises(LimitExceededError, match="too many parts"):
        list(read_parts(_TYPE, iter([_form()]), 4))
