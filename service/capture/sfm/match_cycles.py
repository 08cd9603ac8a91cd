"""Finds image pairs that contradict others by cycles of matches through three images.

With repeated structures, a pair may agree on the wrong copy with a small residual. Cycles reveal it (Zach, Klopschitz
and Pollefeys, CVPR 2010). Matches are composed, not rotations, as a wall's pattern may shift by a tile without one.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.capture.sfm.model_agreement import PairMatches

_Pairs = tuple[tuple[int, int], tuple[int, int], tuple[int, int]]

_SAME_PX = 6.0
_FEWEST = 8  # matches around a cycle that make it count


def contradicting_pairs(matches: PairMatches, pixels: Mapping[int, NDArray[np.float32]]) -> list[tuple[int, int]]:
    """Chooses pairs to remove so that no cycle of three images contradicts itself.

    Greedy: the pair with the largest excess of contradicting over agreeing cycles; on ties, with fewest matches.
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
    """Lists each cycle's pairs and whether it agrees; inconclusive ones are omitted."""
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
    """Checks if most features arrive at the same place; None if inconclusive."""
    rows = np.flatnonzero((first >= 0) & (direct >= 0))
    rows = rows[second[first[rows]] >= 0]
    if len(rows) < _FEWEST:
        return None
    apart = np.linalg.norm(pixels[second[first[rows]]] - pixels[direct[rows]], axis=1)
    return bool((apart <= _SAME_PX).mean() >= 0.5)
