"""Carves pieces of changed space that several later photos agree on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from fastsplat.service.localization.photometric_refinement import Comparison
from fastsplat_contract.geometry.camera import PosedCamera

F64 = NDArray[np.float64]
Bools = NDArray[np.bool_]

FEWEST_VIEWS = 2  # photos that must agree on an event

_CELLS = 64
"""Coarse voxels along the longest side of the place; fine ones are `_FINER` times smaller."""
_FINER = 6
_BAND = 1.0  # voxels before and behind a surface that count as on it
_AGREEING = 0.75  # share of the photos seeing a voxel that must show a change
_AGREEING_FINE = 0.85
_LEAST_LOOKED_AT, _LEAST_BEFORE = 0.3, 0.45
"""Shares of all photos that must show a change on a surface, and before one."""
_FEWEST_PIXELS = 30
_MOST_PIECES = 24
_LEAST_SHARE = 0.55
"""Mean share of differing pixels among those that a piece covers."""
_FREE = 0.5
_AROUND_PX = 7
_SMALL = 0.1
"""Least size of a part of a piece, relative to its largest part."""


@dataclass(frozen=True)
class ChangedPiece:
    """A changed piece of space, carved from voxels."""

    box: F64  # [2, 3], lowest and highest corners, world frame, scene units
    views: tuple[int, ...]  # rows of the photos that show it
    pixels: tuple[Bools, ...]  # [H, W] for each view: covered and differing
    share: float  # mean share of differing pixels


def changed_pieces(
    comparisons: Sequence[Comparison], differing: Sequence[tuple[Bools, Bools]], place: F64, *, on_surface: bool = False
) -> tuple[ChangedPiece, ...]:
    """Finds changed pieces of space that at least two photos agree on.

    A visual hull (Laurentini 1994) in which a voxel counts as changed if three of four photos that see it agree.

    Args:
        differing: two maps [H, W] per comparison: changed, and unknown.
        place: [2, 3], bounds of the searched space.
        on_surface: only the scene's surfaces count, not the space in front of them.
    """
    width = float((place[1] - place[0]).max() / _CELLS)
    fewest = max(FEWEST_VIEWS, round((_LEAST_LOOKED_AT if on_surface else _LEAST_BEFORE) * len(comparisons)))
    carve = partial(_carved, comparisons, differing, fewest=fewest, on_surface=on_surface)
    pieces = []
    for rough, _ in carve(place, width, wide=True)[:_MOST_PIECES]:
        fine = carve(rough + np.array([[-width], [width]]), width / _FINER, wide=False)
        own = [points for _, points in fine if len(points) >= _SMALL * len(fine[0][1])]
        piece = _piece(comparisons, differing, np.concatenate(own), width / _FINER) if own else None
        pieces += [] if piece is None else [piece if on_surface else _centered(piece, comparisons)]
    return tuple(_unexplained(pieces, fewest))


def _carved(
    comparisons: Sequence[Comparison],
    differing: Sequence[tuple[Bools, Bools]],
    place: F64,
    width: float,
    *,
    wide: bool,
    on_surface: bool,
    fewest: int,
) -> list[tuple[F64, F64]]:
    """Carves voxels into connected pieces: box and centers of each, the largest first.

    Args:
        wide: a voxel counts as changed where any of its projection is; otherwise its center decides.
    """
    low, high = place
    counts = np.maximum(np.ceil((high - low) / width), 1).astype(int)
    axes = [start + (np.arange(count) + 0.5) * width for start, count in zip(low, counts, strict=True)]
    centers = np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")], axis=1)
    seen, changed = np.zeros((2, len(centers)), np.int32)
    for comparison, (differs, unknown) in zip(comparisons, differing, strict=True):
        rows, pixels, depth = projected(comparison.posed, centers)
        if not len(rows):
            continue
        surface = comparison.depth.ravel()[pixels]
        sees = (surface > 0) & (depth <= surface + _BAND * width) & ~unknown.ravel()[pixels]
        if on_surface:
            sees &= depth >= surface - _BAND * width
        if wide:
            reach = int(np.ceil(comparison.posed.camera.fx * width / float(np.median(depth))))
            differs = ndimage.maximum_filter(differs, reach | 1)
        seen[rows[sees]] += 1
        changed[rows[sees & differs.ravel()[pixels]]] += 1
    agreeing = (changed >= fewest) & (changed >= (_AGREEING if wide else _AGREEING_FINE) * seen)
    labels, count = ndimage.label(agreeing.reshape(tuple(counts)), np.ones((3, 3, 3)))
    of = labels.ravel()
    sizes = np.bincount(of, minlength=count + 1)[1:]
    boxes = []
    for number in (-sizes).argsort(kind="stable").tolist():
        points = centers[of == number + 1]
        boxes.append((np.stack([points.min(axis=0) - width / 2, points.max(axis=0) + width / 2]), points))
    return boxes


def _piece(
    comparisons: Sequence[Comparison], differing: Sequence[tuple[Bools, Bools]], points: F64, width: float
) -> ChangedPiece | None:
    """Projects voxels to a piece; None where fewer than two photos show enough of it."""
    views, own, shares = [], [], []
    for row, (comparison, (differs, unknown)) in enumerate(zip(comparisons, differing, strict=True)):
        _, pixels, _ = projected(comparison.posed, points)
        covered = np.zeros(differs.shape, np.bool_)
        covered.ravel()[pixels] = True
        covered = ndimage.binary_closing(covered, np.ones((5, 5))) & ~unknown
        if covered.sum() < _FEWEST_PIXELS:
            continue
        shares.append(float(differs[covered].mean()))
        if (covered & differs).sum() >= _FEWEST_PIXELS:
            views.append(row)
            own.append(covered & differs)
    if len(views) < FEWEST_VIEWS or np.mean(shares) < _LEAST_SHARE:
        return None
    box = np.stack([points.min(axis=0) - width / 2, points.max(axis=0) + width / 2])
    return ChangedPiece(box, tuple(views), tuple(own), float(np.mean(shares)))


def _centered(piece: ChangedPiece, comparisons: Sequence[Comparison]) -> ChangedPiece:
    """Centers a piece's box where the rays through its pictures' middles meet.

    Seen from few sides, a hull is too long along the rays, but its content is in the middle. The box never grows.
    """
    normal, right = np.zeros((3, 3)), np.zeros(3)
    for view, own in zip(piece.views, piece.pixels, strict=True):
        posed = comparisons[view].posed
        rows, columns = (place.mean() + 0.5 for place in np.nonzero(own))
        ray = posed.world_from_camera[:3, :3] @ posed.camera.rays(columns, rows)
        across = np.eye(3) - np.outer(ray, ray) / (ray @ ray)
        normal += across
        right += across @ posed.world_from_camera[:3, 3]
    middle = np.linalg.lstsq(normal, right)[0]
    half = np.minimum(middle - piece.box[0], piece.box[1] - middle)
    return replace(piece, box=np.stack([middle - half, middle + half])) if (half > 0).all() else piece


def _unexplained(pieces: Sequence[ChangedPiece], fewest: int) -> list[ChangedPiece]:
    """Drops pieces explained by larger ones: a new object changes what it occludes."""
    kept: list[ChangedPiece] = []
    taken: dict[int, Bools] = {}
    for piece in sorted(pieces, key=lambda each: -sum(int(own.sum()) for own in each.pixels)):
        own_views = 0
        for view, own in zip(piece.views, piece.pixels, strict=True):
            free = own if view not in taken else own & ~taken[view]
            own_views += bool(free.sum() >= _FREE * own.sum())
        if own_views < fewest:
            continue
        kept.append(piece)
        for view, own in zip(piece.views, piece.pixels, strict=True):
            around = ndimage.maximum_filter(own, _AROUND_PX)
            taken[view] = taken[view] | around if view in taken else around
    return kept


def projected(posed: PosedCamera, points: F64) -> tuple[NDArray[np.intp], NDArray[np.intp], F64]:
    """Projects points [K, 3]: rows of those inside the picture, their flat pixels and depths."""
    camera, pose = posed.camera, posed.camera_from_world()
    x, y, z = (points @ pose[:3, :3].T + pose[:3, 3]).T
    ahead = np.flatnonzero(z > 1e-6)
    z = z[ahead]
    column = np.floor(camera.fx * x[ahead] / z + camera.cx).astype(np.intp)
    row = np.floor(camera.fy * y[ahead] / z + camera.cy).astype(np.intp)
    inside = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
    return ahead[inside], row[inside] * camera.width + column[inside], z[inside]
