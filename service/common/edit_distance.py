"""Text edit distance."""

from __future__ import annotations


def text_difference(one: str, other: str, most: float = 1.0) -> float:
    """Levenshtein distance (1966) over the longer length, 0..1; inexact above `most`."""
    longer = max(len(one), len(other))
    if one == other or not longer:
        return 0.0
    least = abs(len(one) - len(other)) / longer
    if least > most:
        return least
    row = list(range(len(other) + 1))
    for at, letter in enumerate(one, start=1):
        before, row = row, [at]
        for column, own in enumerate(other, start=1):
            row.append(min(row[-1] + 1, before[column] + 1, before[column - 1] + (letter != own)))
        if min(row) > most * longer:
            return min(row) / longer
    return row[-1] / longer
