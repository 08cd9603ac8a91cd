"""Which image pairs contradict others: matches followed around three images must come back to where they began.

Where things repeat, a pair may agree on the wrong copy at a fine residual. Loops tell it (Zach, Klopschitz and
Pollefeys, CVPR 2010); matches are composed here, as a wall's pattern moves by a tile without a rotation.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.capture.sfm.model_agreement import PairMatches

_Pairs = tuple[tuple[int, int], tuple[int, int], tuple[int, int]]

_SAME_PX = 6.0
_FEWEST = 8
"""Matches around a loop that make it count."""


def contradicting_pairs(matches: PairMatches, pixels: Mapping[int, NDArray[np.float32]]) -> list[tuple[int, int]]:
    """The pairs to take out so that no loop of three images contradicts itself: again and again the one that is in most
    contradicting loops more than in agreeing ones; of equals the one with fewest matches.

    Args:
        matches: verified, of image pairs (i, j), i < j.
        pixels: [F, 2] of each image's features.
    """
    loops = _loops(matches, pixels)
    of_pair: dict[tuple[int, int], set[int]] = {pair: set() for pair in matches}
    votes, wrong_loops = dict.fromkeys(matches, 0), dict.fromkeys(matches, 0)
    for number, (pairs, agrees) in enumerate(loops):
        for pair in pairs:
            of_pair[pair].add(number)
            votes[pair] += -1 if agrees else 1
            wrong_loops[pair] += not agrees
    wrong = []
    while suspects := [pair for pair, count in wrong_loops.items() if count]:
        worst = max(suspects, key=lambda pair: (votes[pair], -len(matches[pair]), pair))
        wrong.append(worst)
        for number in of_pair[worst].copy():
            pairs, agrees = loops[number]
            for pair in pairs:
                of_pair[pair].remove(number)
                votes[pair] -= -1 if agrees else 1
                wrong_loops[pair] -= not agrees
    return sorted(wrong)


def _loops(matches: PairMatches, pixels: Mapping[int, NDArray[np.float32]]) -> list[tuple[_Pairs, bool]]:
    """Every loop of three images as its pairs, and whether it agrees; those that tell nothing are left out."""
    followed, neighbors = {}, defaultdict(set)
    for (i, j), rows in matches.items():
        followed[i, j] = np.full(len(pixels[i]), -1, np.int32)
        followed[i, j][rows[:, 0]] = rows[:, 1]
        neighbors[i].add(j)
    loops = []
    for i, j in sorted(matches):
        for k in sorted(neighbors[i] & neighbors[j]):
            agrees = _agrees(followed[i, j], followed[j, k], followed[i, k], pixels[k])
            if agrees is not None:
                loops.append((((i, j), (j, k), (i, k)), agrees))
    return loops


def _agrees(
    first: NDArray[np.int32], second: NDArray[np.int32], direct: NDArray[np.int32], pixels: NDArray[np.float32]
) -> bool | None:
    """Whether most features come to the same place in the third image both ways; None where too few tell."""
    rows = np.flatnonzero((first >= 0) & (direct >= 0))
    rows = rows[second[first[rows]] >= 0]
    if len(rows) < _FEWEST:
        return None
    apart = np.linalg.norm(pixels[second[first[rows]]] - pixels[direct[rows]], axis=1)
    return bool((apart <= _SAME_PX).mean() >= 0.5)
