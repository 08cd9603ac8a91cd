"""Which training views are set apart to choose settings by, so that the test views are measured once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fastsplat_contract.errors import InvalidInputError

Split = Literal["test", "validation"]
"""Which views a run measures. `validation`: some of the training views, and the test views are not read at all."""

VALIDATE_EVERY = 5
_FEWEST = 4
_ROUNDS = 20
_DECIMALS = 6


def validation_names(
    names: Sequence[str], poses: Sequence[NDArray[np.floating]], *, every: int = VALIDATE_EVERY
) -> tuple[str, ...]:
    """The names of the training views to validate on, one in `every`, spread over where and whereto the views look.

    The views are divided into as many groups as are validated on, by k-medoids: the first medoid is the view nearest
    to all others, each further one that farthest from those before, and then groups and medoids take turns. A view's
    distance from another is the distance of the cameras, in units of their median distance from their mean, plus the
    angle between their optical axes in radians. Medoids lie inside their groups, so that a validation view has
    training views around it, as test views do that are taken from a path at intervals.

    The order of the views, and the frame and unit of their poses, change nothing.

    Args:
        names: of the training views, each once.
        poses: world_from_camera of each, [4, 4], OpenCV axes.
        every: one view in so many; at least one is validated on.

    Returns:
        Names in alphabetical order, fewer than there are views.

    Raises:
        InvalidInputError: fewer than 4 views, a name twice, other poses than names, or `every` below 2.
    """
    if len(names) < _FEWEST or len(set(names)) < len(names) or len(names) != len(poses):
        raise InvalidInputError(
            f"{len(names)} training views with {len(poses)} poses cannot be split",
            field="split",
            limit=f"{_FEWEST} or more, each with a name of its own",
            hint="Give the data set more training views.",
        )
    if every < 2:
        raise InvalidInputError(f"every {every}th view", field="every", limit="2 or more")
    order = sorted(range(len(names)), key=names.__getitem__)
    distances = _distances(np.stack([np.asarray(poses[row], np.float64) for row in order]))
    return tuple(sorted(names[order[row]] for row in _medoids(distances, max(1, len(names) // every))))


def _distances(poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """[N, N], rounded, so that ties stay ties in another frame."""
    centers, axes = poses[:, :3, 3], poses[:, :3, 2]
    unit = np.median(np.linalg.norm(centers - centers.mean(axis=0), axis=1))
    apart = np.linalg.norm(centers[:, None] - centers[None], axis=2)
    turned = np.arccos(np.clip(axes @ axes.T, -1, 1))
    return np.asarray(np.round(apart / unit + turned if unit > 0 else turned, _DECIMALS))


def _medoids(distances: NDArray[np.float64], count: int) -> list[int]:
    medoids = [int(distances.sum(axis=1).round(_DECIMALS).argmin())]
    while len(medoids) < count:
        nearest = distances[:, medoids].min(axis=1)
        nearest[medoids] = -1
        medoids.append(int(nearest.argmax()))
    for _ in range(_ROUNDS):
        groups = distances[:, medoids].argmin(axis=1)
        groups[medoids] = np.arange(count)
        moved = [_middle(distances, np.flatnonzero(groups == group)) for group in range(count)]
        if moved == medoids:
            break
        medoids = moved
    return medoids


def _middle(distances: NDArray[np.float64], rows: NDArray[np.intp]) -> int:
    return int(rows[distances[np.ix_(rows, rows)].sum(axis=1).round(_DECIMALS).argmin()])
