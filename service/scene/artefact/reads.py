"""Normalizes and bounds text read on objects."""

from __future__ import annotations

import unicodedata
from collections.abc import Iterable, Mapping

from fastsplat_contract.messages.object_reads import ObjectRead

MOST_READS = 24  # per object
MAX_READ_CHARS = 200  # per read


def one_line(text: str) -> str:
    """Normalizes text to one line: NFC, single spaces, no control or format characters."""
    seen = (char for char in text if char.isspace() or unicodedata.category(char)[0] != "C")
    return " ".join(unicodedata.normalize("NFC", "".join(seen)).split())


def tags_of(reads: Iterable[ObjectRead]) -> Mapping[str, float]:
    """Returns the probability of each printed tag by its number."""
    tags = [read for read in reads if read.kind == "tag"]
    return {read.text: read.probability for read in sorted(tags, key=lambda tag: tag.probability)}


def bounded_reads(reads: Iterable[ObjectRead]) -> tuple[ObjectRead, ...]:
    """Keeps the `MOST_READS` likeliest distinct reads.

    Texts longer than `MAX_READ_CHARS` are dropped, not cut: half a code means something else.
    """
    by_line: dict[tuple[str, str], ObjectRead] = {}
    for read in sorted(reads, key=lambda read: -read.probability):
        line = one_line(read.text)
        if 0 < len(line) <= MAX_READ_CHARS and len(by_line) < MOST_READS:
            by_line.setdefault((read.kind, line), read._replace(text=line))
    return tuple(by_line.values())
