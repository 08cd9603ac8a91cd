"""Change detection: events since a scene was made that several later photos agree on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from fastsplat.service.localization.later_views import LaterView
from fastsplat.service.localization.photometric_refinement import Comparison
from fastsplat_contract.photos.localization import ChangeKind, DifferenceKind

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Bools = NDArray[np.bool_]

COMPARED_SIDE = 480  # pixels on the longer side; small objects are a few pixels wide

_ALIKE = 0.65
"""Color similarity, 0..1, from which on gone and new pieces are one moved object."""
_SIZE_RATIO = 2.5
_NEARER = 0.15
"""Similarity deducted per length of the place between both: objects seldom move far."""
_LAB = ((0.0, 100.0), (-60.0, 60.0), (-60.0, 60.0))
_CELLS = (4, 10, 10)

_FEWEST_PIXELS = 30
_SURE_SHARE = 0.5
"""Least share of an object's pixels with a sure depth; other views do not count."""
_LOST_SHARE = 0.5
"""Least share of an object's pixels that the median photo does not show."""
_BORDER_PX, _RING_PX, _MEAN_PX = 5, 13, 9
_ENOUGH = 0.05
_LEAST_STEP = 1e-3
_TOUCHING = np.ones((15, 15), np.uint8)  # regions up to 7 pixels apart touch
_STEPS = 2.5
"""`_step_ratio` of a new object: about 5 on a plain surface; a gap gives 1."""

_FEWEST_VIEWS = 2  # photos that must agree on an event

_MOST_CELLS = 64
"""Coarse voxels along the longest side of the place; fine ones are `_FINER` times smaller."""
_FINER = 6
_BAND = 1.0  # voxels before and behind a surface that count as on it
_AGREEING = 0.75  # share of the photos seeing a voxel that must show a change
_AGREEING_FINE = 0.85
_LEAST_LOOKED_AT, _LEAST_BEFORE = 0.3, 0.45
"""Shares of all photos that must show a change on a surface, and before one."""
_MOST_PIECES = 24
_LEAST_SHARE = 0.55
"""Mean share of differing pixels among those that a piece covers."""
_FREE = 0.5
_AROUND_PX = 7
_SMALL = 0.1
"""Least size of a part of a piece, relative to its largest part."""


@dataclass(frozen=True)
class Region:
    """Bounding box of an event in a photo."""

    view: int  # row of the photo
    kind: DifferenceKind  # "missing": only in the scene; "new": only in the photo
    box: tuple[int, int, int, int]  # left, top, right, bottom, pixels of the comparison


@dataclass(frozen=True)
class Change:
    """An event, with its places before and after."""

    kind: ChangeKind
    object_id: int  # its id in the scene; 0 if it is none of the scene's objects
    views: tuple[int, ...]  # rows of the photos that agree
    probability: float
    before: F64 | None  # [2, 3], lowest and highest corners, world frame, scene units
    after: F64 | None
    regions: tuple[Region, ...]


@dataclass(frozen=True)
class Changes:
    """Result of the change detection."""

    events: tuple[Change, ...]  # the surest first
    seen: tuple[int, ...]  # ids of the objects that at least two photos should show


def find_changes(
    views: Sequence[LaterView], boxes: Mapping[int, F64], place: F64, surfaces: frozenset[int] = frozenset()
) -> Changes:
    """Finds events that at least two photos agree on.

    - gone: an object half of whose pixels have colors that the median photo lacks nearby, or a surface piece like that.
    - new: space on or before the scene's surfaces whose projections have colors that the scene has not.
    - moved: a gone and a new piece that look alike.
    - changed: a gone object at whose border the photos have a strong color step, too.

    Color steps at the border tell which picture shows an object before the other's background.

    Args:
        boxes: [2, 3] of each object, lowest and highest corners, scene units.
        place: [2, 3], bounds of the searched space.
        surfaces: ids of floors, walls and tables, which are never gone.
    """
    lost, seen = lost_objects(views, boxes, surfaces)
    lost += _lost_pieces(views, lost, place)
    comparisons, around = [view.comparison for view in views], zip(views, pixels_of(views, lost), strict=True)
    maps = [(view.only_in_photo, view.unknown(aside, view.comparison.covered)) for view, aside in around]
    pieces = changed_pieces(comparisons, maps, place)
    events = _events(comparisons, whole(lost), pieces, float((place[1] - place[0]).max()))
    return Changes(tuple(sorted(events, key=lambda event: -event.probability)), tuple(seen))


def _events(
    comparisons: Sequence[Comparison], lost: Sequence[Lost], pieces: Sequence[ChangedPiece], length: float
) -> list[Change]:
    looks_lost = [_colors([comparison.rendering for comparison in comparisons], loss) for loss in lost]
    looks_new = [_colors([comparison.photo for comparison in comparisons], piece) for piece in pieces]
    pairs = []
    for row, loss in enumerate(lost):
        for number, piece in enumerate(pieces):
            likeness = _likeness(looks_lost[row], looks_new[number])
            if likeness >= _ALIKE and _size_ratio(loss.box, piece.box) <= _SIZE_RATIO:
                distance = float(np.linalg.norm((loss.box - piece.box).mean(axis=0)))
                pairs.append((likeness - _NEARER * distance / length, row, number))
    moved: dict[int, int] = {}
    for _, row, number in sorted(pairs, reverse=True):
        if row not in moved and number not in moved.values():
            moved[row] = number
    left = [piece for number, piece in enumerate(pieces) if number not in moved.values()]
    events: list[Change] = []
    for row, loss in enumerate(lost):
        sure, regions = _sure(loss), _regions(loss, "missing")
        if row in moved:
            piece = pieces[moved[row]]
            sure, regions = min(sure, _sure(piece)), (*regions, *_regions(piece, "new"))
            views = tuple(sorted({*loss.views, *piece.views}))
            events.append(Change("moved", loss.object_id, views, sure, loss.box, piece.box, regions))
        elif loss.step > _STEPS:
            events.append(Change("changed", loss.object_id, loss.views, sure, loss.box, loss.box, regions))
        else:
            events.append(Change("gone", loss.object_id, loss.views, sure, loss.box, None, regions))
    for piece in left:
        events.append(Change("new", 0, piece.views, _sure(piece), None, piece.box, _regions(piece, "new")))
    return events


def _regions(of: ChangedPiece, kind: DifferenceKind) -> tuple[Region, ...]:
    return tuple(Region(row, kind, _around(mask)) for row, mask in zip(of.views, of.pixels, strict=True))


def _around(pixels: Bools) -> tuple[int, int, int, int]:
    rows, columns = np.nonzero(pixels)
    return int(columns.min()), int(rows.min()), int(columns.max()) + 1, int(rows.max()) + 1


def _sure(of: ChangedPiece) -> float:
    """Combines the share of changed pixels and the number of agreeing photos, 0..1."""
    return float(of.share * (1 - 0.5 ** len(of.views)))


def _size_ratio(first: F64, second: F64) -> float:
    lengths = [max(float(np.linalg.norm(box[1] - box[0])), 1e-9) for box in (first, second)]
    return max(lengths) / min(lengths)


def _colors(pictures: Sequence[F32], of: ChangedPiece) -> F64:
    """CIELAB histogram of a region, float64 [K], sum 1; few brightness bins because light differs."""
    colors = np.concatenate([pictures[row][mask] for row, mask in zip(of.views, of.pixels, strict=True)])
    if not len(colors):
        return np.zeros(int(np.prod(_CELLS)))
    lab = cv2.cvtColor(colors[None].astype(np.float32), cv2.COLOR_RGB2LAB)[0]
    counts, _ = np.histogramdd(lab.clip(*np.array(_LAB).T), bins=_CELLS, range=_LAB)
    return np.asarray(counts.ravel() / counts.sum(), np.float64)


def _likeness(first: F64, second: F64) -> float:
    """Bhattacharyya coefficient (1943) of two histograms, 0..1."""
    return float(np.sqrt(first * second).sum())


@dataclass(frozen=True)
class ChangedPiece:
    """A changed piece of space, carved from voxels."""

    box: F64  # [2, 3], lowest and highest corners, world frame, scene units
    views: tuple[int, ...]  # rows of the photos that show it
    pixels: tuple[Bools, ...]  # [H, W] for each view: covered and differing
    share: float  # mean share of differing pixels


@dataclass(frozen=True)
class Lost(ChangedPiece):
    """An object or surface piece that is not where it was; pixels of an object are all that the scene shows."""

    object_id: int  # its id; 0 if it is none of the scene's objects
    step: float  # see `_step_ratio`; above `_STEPS`, something else stands there


def lost_objects(
    views: Sequence[LaterView], boxes: Mapping[int, F64], surfaces: frozenset[int]
) -> tuple[list[Lost], list[int]]:
    """Finds lost objects, and the ids of objects that at least two photos should show.

    An object is lost if the median photo lacks the colors of half of its pixels.

    Args:
        boxes: [2, 3] of each object.
        surfaces: ids that are never lost.
    """
    shares: dict[int, list[tuple[int, float]]] = {obj: [] for obj in sorted(boxes)}
    most = max([*boxes, *(int(view.objects.max(initial=0)) for view in views)], default=0) + 1
    for row, view in enumerate(views):
        ids = np.where(view.comparison.sure, view.objects, 0)
        pixels, whole = (np.bincount(id_map.ravel(), minlength=most) for id_map in (ids, view.objects))
        changed = np.bincount(ids[view.missing], minlength=most)
        for obj, object_shares in shares.items():
            if pixels[obj] >= max(_FEWEST_PIXELS, _SURE_SHARE * whole[obj]):
                object_shares.append((row, float(changed[obj] / pixels[obj])))
    seen = [obj for obj, object_shares in shares.items() if len(object_shares) >= _FEWEST_VIEWS]
    lost = []
    for obj in (object_id for object_id in seen if object_id not in surfaces):
        share = float(np.median([fraction for _, fraction in shares[obj]]))
        agreeing = tuple(row for row, fraction in shares[obj] if fraction >= _LOST_SHARE)
        if share >= _LOST_SHARE and len(agreeing) >= _FEWEST_VIEWS:
            own_pixels = tuple(views[row].objects == obj for row in agreeing)
            step = _step_ratio(agreeing, own_pixels, views)
            lost.append(Lost(boxes[obj], agreeing, own_pixels, share, obj, step))
    return lost, seen


def _lost_pieces(views: Sequence[LaterView], lost: Sequence[Lost], place: F64) -> list[Lost]:
    """Finds lost surface pieces outside of `lost` objects, without a larger color step at the border."""
    comparisons, around = [view.comparison for view in views], zip(views, pixels_of(views, lost), strict=True)
    maps = [(view.only_in_scene, view.unknown(aside, view.comparison.sure)) for view, aside in around]
    found = []
    for piece in changed_pieces(comparisons, maps, place, on_surface=True):
        step = _step_ratio(piece.views, piece.pixels, views)
        if step < _STEPS:
            found.append(Lost(**vars(piece), object_id=0, step=step))
    return found


def whole(lost: Sequence[Lost]) -> list[Lost]:
    """Drops pieces that touch a kept item in half of the photos of both.

    One object is often several of the scene's objects, or extends beyond them.
    """
    losses: list[Lost] = []
    for loss in lost:
        if loss.object_id or not any(_touches(loss, earlier) for earlier in losses):
            losses.append(loss)
    return losses


def _touches(first: Lost, second: Lost) -> bool:
    pixels = dict(zip(second.views, second.pixels, strict=True))
    both = [(mask, pixels[view]) for view, mask in zip(first.views, first.pixels, strict=True) if view in pixels]
    touching = [bool((cv2.dilate(mask.astype(np.uint8), _TOUCHING)[its] > 0).any()) for mask, its in both]
    return bool(both) and 2 * sum(touching) >= len(both)


def pixels_of(views: Sequence[LaterView], lost: Sequence[Lost]) -> list[Bools]:
    """Masks lost objects and all surface in lost pieces' boxes, [H, W] per photo."""
    taken = sorted({loss.object_id for loss in lost if loss.object_id})
    boxes = [loss.box for loss in lost if not loss.object_id]
    maps = [np.isin(view.objects, taken) for view in views]
    for view, mask in zip(views, maps, strict=True):
        points = _surface(view.comparison) if boxes else np.zeros(0)
        for low, high in boxes:
            mask |= ((points >= low) & (points <= high)).all(axis=2)
    return maps


def _surface(comparison: Comparison) -> F64:
    """World point of each pixel, float64 [H, W, 3]; NaN where nothing is."""
    rows, columns = np.indices(comparison.depth.shape) + 0.5
    return comparison.posed.places(columns, rows, np.where(comparison.depth > 0, comparison.depth, np.nan))


def _step_ratio(rows: Sequence[int], pixels: Sequence[Bools], views: Sequence[LaterView]) -> float:
    """Ratio of color steps at a region's border, photo to scene, in the median photo; 1 if all around is changed."""
    ratios = []
    for row, mask in zip(rows, pixels, strict=True):
        pictures = views[row].comparison.photo, views[row].comparison.rendering
        in_photo, in_scene = (_step(picture, mask, views[row].same) + _LEAST_STEP for picture in pictures)
        ratios.append(in_photo / in_scene)
    return float(np.median(ratios))


def _step(picture: F32, mask: Bools, free: Bools) -> float:
    """Lower quartile of color differences, by local means, across a region's border to `free` pixels, 0..1."""
    # A quartile, as an object has a border all around while a pattern has edges only somewhere.
    region = mask.astype(np.uint8)
    near = cv2.dilate(region, np.ones((_BORDER_PX, _BORDER_PX))) > 0
    around = (cv2.dilate(region, np.ones((_RING_PX, _RING_PX))) > 0) & ~near & free
    inner = cv2.erode(region, np.ones((3, 3))) > 0
    (inside, weight), (outside, weight_out) = (_local_mean(picture, part) for part in (mask, around))
    border = near & ~inner & (weight > _ENOUGH) & (weight_out > _ENOUGH)
    return float(np.quantile(np.abs(inside - outside).max(axis=2)[border], 0.25)) if border.any() else 0.0


def _local_mean(picture: F32, part: Bools) -> tuple[F32, F32]:
    """Local mean of a picture's part, [H, W, 3], and its weight, [H, W]."""
    size = _MEAN_PX, _MEAN_PX
    weight = cv2.blur(part.astype(np.float32), size)
    mean = cv2.blur(picture * part[..., None], size) / np.maximum(weight, 1e-6)[..., None]
    return np.asarray(mean, np.float32), np.asarray(weight, np.float32)


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
    width = float((place[1] - place[0]).max() / _MOST_CELLS)
    fewest = max(_FEWEST_VIEWS, round((_LEAST_LOOKED_AT if on_surface else _LEAST_BEFORE) * len(comparisons)))
    carve = partial(_carved, comparisons, differing, fewest=fewest, on_surface=on_surface)
    pieces = []
    for rough, _ in carve(place, width, wide=True)[:_MOST_PIECES]:
        fine = carve(rough + np.array([[-width], [width]]), width / _FINER, wide=False)
        clusters = [points for _, points in fine if len(points) >= _SMALL * len(fine[0][1])]
        piece = _piece(comparisons, differing, np.concatenate(clusters), width / _FINER) if clusters else None
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
    """Box and centers of each connected piece, the largest first; `wide`: any of a voxel's pixels decides."""
    low, high = place
    counts = np.maximum(np.ceil((high - low) / width), 1).astype(int)
    axes = [start + (np.arange(count) + 0.5) * width for start, count in zip(low, counts, strict=True)]
    centers = np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")], axis=1)
    seen, changed = np.zeros((2, len(centers)), np.int32)
    for comparison, (differs, unknown) in zip(comparisons, differing, strict=True):
        rows, at, depth = comparison.posed.in_picture(centers)
        if not len(rows):
            continue
        x, y = at.astype(np.intp).T
        surface = comparison.depth[y, x]
        sees = (surface > 0) & (depth <= surface + _BAND * width) & ~unknown[y, x]
        if on_surface:
            sees &= depth >= surface - _BAND * width
        if wide:
            reach = int(np.ceil(comparison.posed.camera.fx * width / float(np.median(depth))))
            differs = ndimage.maximum_filter(differs, reach | 1)
        seen[rows[sees]] += 1
        changed[rows[sees & differs[y, x]]] += 1
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
    views, masks, shares = [], [], []
    for row, (comparison, (differs, unknown)) in enumerate(zip(comparisons, differing, strict=True)):
        x, y = comparison.posed.in_picture(points)[1].astype(np.intp).T
        covered = np.zeros(differs.shape, np.bool_)
        covered[y, x] = True
        covered = ndimage.binary_closing(covered, np.ones((5, 5))) & ~unknown
        if covered.sum() < _FEWEST_PIXELS:
            continue
        shares.append(float(differs[covered].mean()))
        if (covered & differs).sum() >= _FEWEST_PIXELS:
            views.append(row)
            masks.append(covered & differs)
    if len(views) < _FEWEST_VIEWS or np.mean(shares) < _LEAST_SHARE:
        return None
    box = np.stack([points.min(axis=0) - width / 2, points.max(axis=0) + width / 2])
    return ChangedPiece(box, tuple(views), tuple(masks), float(np.mean(shares)))


def _centered(piece: ChangedPiece, comparisons: Sequence[Comparison]) -> ChangedPiece:
    """Shrinks a piece's box around where the rays through its pictures' middles meet."""
    # Seen from few sides, a hull is too long along the rays, but its content is in the middle.
    normal, right = np.zeros((3, 3)), np.zeros(3)
    for view, mask in zip(piece.views, piece.pixels, strict=True):
        posed = comparisons[view].posed
        rows, columns = (place.mean() + 0.5 for place in np.nonzero(mask))
        ray = posed.world_from_camera[:3, :3] @ posed.camera.rays(columns, rows)
        across = np.eye(3) - np.outer(ray, ray) / (ray @ ray)
        normal += across
        right += across @ posed.world_from_camera[:3, 3]
    middle = np.linalg.lstsq(normal, right)[0]
    half = np.minimum(middle - piece.box[0], piece.box[1] - middle)
    return replace(piece, box=np.stack([middle - half, middle + half])) if (half > 0).all() else piece


def _unexplained(pieces: Sequence[ChangedPiece], fewest: int) -> list[ChangedPiece]:
    """Drops pieces explained by larger ones: a new object changes what it occludes."""
    result: list[ChangedPiece] = []
    taken: dict[int, Bools] = {}
    for piece in sorted(pieces, key=lambda piece: -sum(int(mask.sum()) for mask in piece.pixels)):
        own_views = 0
        for view, mask in zip(piece.views, piece.pixels, strict=True):
            free = mask if view not in taken else mask & ~taken[view]
            own_views += bool(free.sum() >= _FREE * mask.sum())
        if own_views < fewest:
            continue
        result.append(piece)
        for view, mask in zip(piece.views, piece.pixels, strict=True):
            around = ndimage.maximum_filter(mask, _AROUND_PX)
            taken[view] = taken[view] | around if view in taken else around
    return result
