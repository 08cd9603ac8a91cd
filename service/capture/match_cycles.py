"""Which image pairs contradict others: matches followed around three images must come back to where they began.

Where things repeat, a pair may agree on the wrong one of two copies, at a fine residual. Followed from image to image,
its matches then end on another copy than the direct ones do. Loops as evidence of wrong pairs: Zach, Klopschitz and
Pollefeys, "Disambiguating visual relations using loop constraints", CVPR 2010, who compose relative poses; here the
matches themselves are composed, as the pattern of a wall moves by a tile without any rotation that a loop would show.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.capture.model_agreement import PairMatches

_SAME_PX = 6.0
_FEWEST = 8
"""Matches around a loop that make it count."""


def contradicting_pairs(matches: PairMatches, pixels: Mapping[int, NDArray[np.float32]]) -> list[tuple[int, int]]:
    """The pairs to take out so that no loop of three images contradicts itself: again and again the one that is in most
    contradicting loops more than in agreeing ones; of equals the one with fewest matches.

    Args:
        matches: verified, of image pairs (i, j).
        pixels: [F, 2] of each image's features.
    """
    followed = {}
    for (i, j), rows in matches.items():
        for key, source, target in (((i, j), rows[:, 0], rows[:, 1]), ((j, i), rows[:, 1], rows[:, 0])):
            followed[key] = np.full(len(pixels[key[0]]), -1, np.int64)
            followed[key][source] = target
    loops: list[tuple[tuple[tuple[int, int], ...], bool]] = []
    for i, j, k in combinations(sorted({image for pair in matches for image in pair}), 3):
        if (i, j) in followed and (j, k) in followed and (i, k) in followed:
            agrees = _agrees(followed[i, j], followed[j, k], followed[i, k], pixels[k])
            if agrees is not None:
                loops.append((tuple(_stored(pair, matches) for pair in ((i, j), (j, k), (i, k))), agrees))
    wrong = []
    while any(not agrees for _, agrees in loops):
        votes = dict.fromkeys(matches, 0)
        for pairs, agrees in loops:
            for pair in pairs:
                votes[pair] += -1 if agrees else 1
        suspects = {pair for pairs, agrees in loops if not agrees for pair in pairs}
        worst = max(suspects, key=lambda pair: (votes[pair], -len(matches[pair]), pair))
        wrong.append(worst)
        loops = [(pairs, agrees) for pairs, agrees in loops if worst not in pairs]
    return sorted(wrong)


def _agrees(
    first: NDArray[np.int64], second: NDArray[np.int64], direct: NDArray[np.int64], pixels: NDArray[np.float32]
) -> bool | None:
    """Whether most features come to the same place in the third image both ways; None where too few tell."""
    rows = np.flatnonzero((first >= 0) & (direct >= 0))
    rows = rows[second[first[rows]] >= 0]
    if len(rows) < _FEWEST:
        return None
    apart = np.linalg.norm(pixels[second[first[rows]]] - pixels[direct[rows]], axis=1)
    return bool((apart <= _SAME_PX).mean() >= 0.5)


def _stored(pair: tuple[int, int], matches: PairMatches) -> tuple[int, int]:
    return pair if pair in matches else (pair[1], pair[0])
