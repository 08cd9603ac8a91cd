"""What is printed for people fits 80 columns whatever the data, and ids in short mean one object or are refused."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as some
from rich.cells import cell_len

from fastsplat.cli.short_ids import LEAST, whole_id
from fastsplat.cli.tables import WIDTH, Column, facts, size, table
from fastsplat_contract.errors import InvalidInputError, NotFoundError

_TEXTS = some.one_of(some.text(max_size=250), some.text(alphabet="名a é\x1b\t", min_size=30, max_size=250))
_IDS = some.sets(some.text(alphabet="ab", min_size=6, max_size=6), min_size=1, max_size=40)


@given(some.lists(some.tuples(_TEXTS, _TEXTS, some.integers(0, 10**9)), min_size=1, max_size=5))
def test_no_line_is_wider_than_a_terminal_and_nothing_moves_its_cursor(rows: list[tuple[str, str, int]]) -> None:
    columns = (Column("id"), Column("name", "cut"), Column("advice", "wrap"), Column("count", right=True))
    printed = table(columns, [("12345678", name, advice, f"{count:,}") for name, advice, count in rows])
    for line in printed.split("\n"):
        assert cell_len(line) <= WIDTH and line.isprintable()
    assert all(cell_len(line) <= WIDTH for line in facts([("name", rows[0][0]), ("advice", rows[0][1])]).split("\n"))


@given(some.text(alphabet="ab cd", max_size=300))
def test_what_is_wrapped_loses_no_word(text: str) -> None:
    lines = facts([("advice", f"x{text}")]).split("\n")
    said = "".join(line.removeprefix("advice") for line in lines)
    assert re.sub(" ", "", said) == re.sub(" ", "", f"x{text}")


def test_what_is_cut_says_so_and_what_fits_is_whole() -> None:
    columns = (Column("name", "cut"), Column("state"))
    heading, cut, whole = table(columns, [("x" * 200, "READY"), ("mug", "READY")]).split("\n")
    assert cell_len(heading.partition("state")[0]) == cell_len(cut.partition("READY")[0]) and len(cut) == WIDTH
    assert re.fullmatch("x+…  READY", cut) and re.fullmatch("mug +READY", whole)
    assert table(columns, []) == "" and facts([("name", "")]) == ""


@given(_IDS, some.integers(0, 6), some.data())
def test_a_beginning_is_the_one_id_that_begins_so_or_is_refused(
    ids: set[str], length: int, data: some.DataObject
) -> None:
    text = data.draw(some.sampled_from(sorted(ids)))[:length]
    fitting = {name for name in ids if name.startswith(text)}
    if text in ids or (len(fitting) == 1 and length >= LEAST):
        assert {whole_id("scene", text, sorted(ids))} == ({text} if text in ids else fitting)
        return
    with pytest.raises(InvalidInputError) as refused:
        whole_id("scene", text, sorted(ids))
    if length >= LEAST:
        named = set(re.findall(r"\b[ab]{6}\b", refused.value.hint))
        assert named <= fitting and len(named) == min(len(fitting), 5)


def test_an_ambiguous_beginning_names_those_that_may_be_meant() -> None:
    with pytest.raises(InvalidInputError, match="begins the ids of 2 jobs") as refused:
        whole_id("job", "abcd", ["abcdef", "abcd12", "abc456"])
    assert "abcd12, abcdef" in refused.value.hint


def test_what_begins_no_id_is_not_found() -> None:
    for text in ("zzzz", "abcdabcdabcd"):
        with pytest.raises(NotFoundError, match="no job has the id"):
            whole_id("job", text, ["abcdabcd"])


def test_sizes_are_said_in_few_letters() -> None:
    assert [size(count) for count in (0, 999, 1_000, 999_999, 3_200_000)] == ["0 B", "999 B", "1 kB", "1 MB", "3.2 MB"]
