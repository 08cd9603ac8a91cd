"""What is written on things: bounded in number and length, on one line each."""

from __future__ import annotations

import unicodedata
from collections.abc import Iterable, Mapping

from fastsplat_contract.thing_reads import ThingRead

MOST_READS = 24
"""Of one thing."""
MAX_READ_CHARS = 200
"""Of one read."""


def one_line(text: str) -> str:
    """A text as a read has it: composed letters, white space as single spaces, and no other character that is not
    seen: none that controls a terminal or turns the direction of writing."""
    seen = (each for each in text if each.isspace() or unicodedata.category(each)[0] != "C")
    return " ".join(unicodedata.normalize("NFC", "".join(seen)).split())


def tags_of(reads: Iterable[ThingRead]) -> Mapping[str, float]:
    """The printed tags among reads: how probable each is, by its number."""
    tags = [read for read in reads if read.kind == "tag"]
    return {read.text: read.probability for read in sorted(tags, key=lambda one: one.probability)}


def bounded_reads(reads: Iterable[ThingRead]) -> tuple[ThingRead, ...]:
    """At most `MOST_READS`, the likeliest first, each text once; texts of more than `MAX_READ_CHARS` are left out,
    since half of a code means something else."""
    kept: dict[tuple[str, str], ThingRead] = {}
    for read in sorted(reads, key=lambda one: -one.probability):
        line = one_line(read.text)
        if 0 < len(line) <= MAX_READ_CHARS and len(kept) < MOST_READS:
            kept.setdefault((read.kind, line), read._replace(text=line))
    return tuple(kept.values())
