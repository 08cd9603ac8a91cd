"""Text edit distance."""

from __future__ import annotations


def text_difference(first: str, second: str, most: float = 1.0) -> float:
    """Levenshtein distance (1966) over the longer length, 0..1; inexact above `most`."""
    longer = max(len(first), len(second))
    if first == second or not longer:
        return 0.0
    least = abs(len(first) - len(second)) / longer
    if least > most:
        return least
    row = list(range(len(second) + 1))
    for at, letter in enumerate(first, start=1):
        before, row = row, [at]
        for column, other_letter in enumerate(second, start=1):
            row.append(min(row[-1] + 1, before[column] + 1, before[column - 1] + (letter != other_letter)))
        if min(row) > most * longer:
            return min(row) / longer
    return row[-1] / longer
