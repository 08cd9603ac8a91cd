"""2D occupancy map of the floor from the cameras' depth: free, occupied, unknown."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.common.cancellation import check_cancelled
from fastsplat.service.query.objects.floors import LEAST_BELOW, meters_below
from fastsplat.service.query.surfaces.surface_points import MAX_SURFACE_POINTS, REACH, surface_points, thinned
from fastsplat.service.query.surfaces.surface_views import SurfaceSamples, SurfaceView, back_projected
from fastsplat.service.scene.artefact.scene import F32, Scene
from fastsplat_contract.errors import InvalidInputError, LimitExceededError
from fastsplat_contract.messages.goals import FloorSource

MAX_MAP_CELLS = 4_000_000
"""Most cells of a map."""

F64 = NDArray[np.float64]
Keys = NDArray[np.int64]

FREE, OCCUPIED, UNKNOWN = 0, 100, -1
"""Cell values, as in nav_msgs/OccupancyGrid."""

RESOLUTION = 0.05
"""Default cell width, meters."""
CLEARANCE = 0.1
"""Height of surfaces that count as floor, meters; exceeds a trained scene's depth error."""
LOW = 0.25
"""Height of rays that free the cells below, meters: any obstacle would stop them."""

_MOST_TILT = 3.0
"""Most tilt and deviation of the vertical, degrees: 0.16 m of height over 3 m."""
_LEVEL_BIN = 0.05
_LEVEL_SHARE = 0.25
"""Least density of the floor level, relative to the densest level."""
_FACING_UP = 0.8
_SAMPLES_AT_ONCE = 1 << 20


@dataclass(frozen=True)
class OccupancyMap:
    """Occupancy grid of the floor in the scene's frame, z up."""

    cells: NDArray[np.int8]  # int8 [H, W], `FREE`, `OCCUPIED` or `UNKNOWN`; least y in row 0, least x in column 0
    tops: F32  # float32 [H, W], z of the highest surface in the robot's band, −inf where there is none
    resolution: float  # width of a cell, meters
    origin: tuple[float, float]  # x and y of the outer corner of cell [0, 0], meters; multiples of `resolution`
    floor: float  # its z, meters
    floor_source: FloorSource  # see `FloorSource`
    floor_doubt: str  # why the floor may be a table top or the like, words; "" where nothing says so
    height: float  # of the band above the floor, meters


def check_map_frame(scene: Scene) -> None:
    """Raises InvalidInputError unless a scene is metric with `vertical` within 3° of +z."""
    if scene.scale != "METRIC":
        raise InvalidInputError(
            "a map needs meters, and this scene's unit is arbitrary",
            field="scene_id",
            hint="Scale the scene by a known length, or upload with poses in meters.",
        )
    vertical = scene.vertical()
    if vertical is None or vertical.deviation_deg > _MOST_TILT:
        raise InvalidInputError(
            "a map needs to know what is up, and this scene does not tell",
            field="scene_id",
            limit=f"1 sigma of the vertical of at most {_MOST_TILT:g} degrees",
            hint="Take photos with a level camera from several directions, and send them as the phone wrote them.",
        )
    tilt = float(np.degrees(np.arccos(np.clip(vertical.up.z, -1, 1))))
    if tilt > _MOST_TILT:
        raise InvalidInputError(
            f"up is {tilt:.1f} degrees away from the scene's z axis",
            field="scene_id",
            limit=f"at most {_MOST_TILT:g} degrees",
            hint="Align the scene to a frame whose z axis is up.",
        )


def occupancy_map(
    views: Sequence[SurfaceView],
    floors: Collection[int],  # ids of floor objects; the one with the most points counts
    other_names: Mapping[int, str],  # names of objects that are no floors, by id
    *,
    resolution: float,  # width of a cell, meters
    height: float,  # of the robot, meters above the floor
    most_points: int = MAX_SURFACE_POINTS,
    most_cells: int = MAX_MAP_CELLS,
) -> OccupancyMap:
    """Builds the occupancy map of a scene that passes `check_map_frame`; cancellable.

    A cell is occupied if several views agree on a surface (see `surface_points`) between `CLEARANCE` and `height` above
    the floor. Other cells are free if a ray from a camera to the surface it sees passes over them below `LOW`. The rest
    is unknown: nothing was seen there, or a surface in it or in a neighboring cell lies below the floor, as steps down
    and mirror images do.

    Raises:
        InvalidInputError: an invalid resolution or height, or no floor is seen.
        LimitExceededError: more points or cells than allowed.
    """
    if not (np.isfinite(resolution) and resolution > 0):
        raise InvalidInputError(f"a cell of {resolution} m", field="cell", hint="Meters, above 0.")
    if not (np.isfinite(height) and height > LOW):
        raise InvalidInputError(f"a height of {height} m", field="height", hint=f"Meters, above {LOW:g}.")
    samples, _ = surface_points(views, cell=resolution, most=most_points)
    floor, source = _floor(samples, floors)
    doubt = "" if source == "surface" else _doubt(samples, views, floor, other_names)
    above = samples.points[:, 2] - floor
    band = samples.points[(above > CLEARANCE) & (above <= height)].astype(np.float64)
    standing, places = np.unique(_keys(band[:, :2], resolution), return_inverse=True)
    tops = np.full(len(standing), -np.inf, np.float32)
    np.maximum.at(tops, places, band[:, 2].astype(np.float32))
    lower = _keys(samples.points[above < -CLEARANCE, :2].astype(np.float64), resolution)
    passed = [_passed(view, floor, resolution) for view in views]
    widened = lower[:, None] + [(x << 21) + y for x in (-1, 0, 1) for y in (-1, 0, 1)]  # with the eight neighbors
    free = np.setdiff1d(np.concatenate([*passed, np.zeros(0, np.int64)]), widened.ravel())
    columns, rows = _steps(np.concatenate([standing, free]))
    if not len(columns):
        raise InvalidInputError(
            "no camera sees the floor or what stands on it", field="scene_id", hint="Take photos that show the floor."
        )
    left, low = int(columns.min()) - 1, int(rows.min()) - 1
    width, depth = int(columns.max()) - left + 2, int(rows.max()) - low + 2
    if width * depth > most_cells:
        raise LimitExceededError(
            f"a map of {width} x {depth} cells of {resolution:g} m",
            field="cell",
            limit=f"{most_cells} cells",
            hint="Ask for a larger cell.",
        )
    cells = np.full((depth, width), UNKNOWN, np.int8)
    heights = np.full((depth, width), -np.inf, np.float32)
    cells[rows[len(standing) :] - low, columns[len(standing) :] - left] = FREE
    cells[rows[: len(standing)] - low, columns[: len(standing)] - left] = OCCUPIED
    heights[rows[: len(standing)] - low, columns[: len(standing)] - left] = tops
    origin = (left * resolution, low * resolution)
    return OccupancyMap(cells, heights, resolution, origin, floor, source, doubt, height)


def _floor(samples: SurfaceSamples, floors: Collection[int]) -> tuple[float, FloorSource]:
    """Estimates the floor's z and names its source."""
    counts = {obj: int((samples.objects == obj).sum()) for obj in floors}
    if counts and max(counts.values()):
        largest = max(counts, key=lambda obj: counts[obj])
        return float(np.median(samples.points[samples.objects == largest, 2])), "surface"
    heights = samples.points[samples.normals[:, 2] > _FACING_UP, 2].astype(np.float64)
    if not len(heights):
        raise InvalidInputError(
            "no camera sees a floor: no surface faces up", field="scene_id", hint="Take photos that show the floor."
        )
    ends = np.floor([heights.min() / _LEVEL_BIN, heights.max() / _LEVEL_BIN]).astype(int)
    numbers = np.floor(heights / _LEVEL_BIN).astype(int) - ends[0]
    dense = np.convolve(np.bincount(numbers, minlength=int(ends[1] - ends[0]) + 1), np.ones(3), mode="same")
    first = int(np.flatnonzero(dense >= _LEVEL_SHARE * dense.max())[0])
    best = first + int(np.argmax(dense[first : first + 3]))  # the level itself, not the edge of its bins
    return float(np.median(heights[np.abs(numbers - best) <= 1])), "lowest_level"


def _doubt(samples: SurfaceSamples, views: Sequence[SurfaceView], floor: float, other_names: Mapping[int, str]) -> str:
    """Reason to doubt the floor: another object's surface, or too near the cameras."""
    level = samples.objects[np.abs(samples.points[:, 2] - floor) <= _LEVEL_BIN]
    ids, counts = np.unique(level, return_counts=True)
    most = int(ids[counts.argmax()]) if len(ids) else 0
    if most in other_names and 2 * counts.max() > len(level):
        return f"it is the upper side of object {most}, {other_names[most]!r}"
    below = meters_below([view.posed for view in views], np.array([0.0, 0.0, 1.0]), floor)
    return f"it lies {below:.2f} m below the cameras, as table tops do" if below < LEAST_BELOW else ""


def _passed(view: SurfaceView, floor: float, resolution: float) -> Keys:
    """Keys of the cells over which a view's rays pass below `LOW`, int64 [K]."""
    check_cancelled()
    eye = np.asarray(view.posed.world_from_camera[:3, 3], np.float64)
    if eye[2] <= floor:
        return np.zeros(0, np.int64)
    ends = thinned([back_projected(view)], resolution).astype(np.float64)
    above = ends[:, 2] - floor
    rows = (above <= LOW) & (above >= -CLEARANCE)
    ends, above = ends[rows], above[rows]
    rays = ends - eye
    lengths = np.maximum(np.linalg.norm(rays[:, :2], axis=1), 1e-9)
    with np.errstate(divide="ignore", invalid="ignore"):
        enters = np.where(eye[2] > floor + LOW, (floor + LOW - eye[2]) / rays[:, 2], 0.0)
    # A ray that ends on an obstacle does not free the last cell before it.
    leaves = np.where(above <= CLEARANCE, 1.0, 1.0 - resolution / lengths)
    counts = np.ceil(np.maximum(leaves - enters, 0) * lengths / (resolution / 2)).astype(np.int64) + 1
    counts[leaves < enters] = 0
    parts = [np.zeros(0, np.int64)]
    for some in _chunks(counts):
        ray_ids = np.repeat(some, counts[some])
        first = np.repeat(np.cumsum(counts[some]) - counts[some], counts[some])
        share = (np.arange(len(ray_ids)) - first) / np.maximum(counts[ray_ids] - 1, 1)
        along = leaves[ray_ids] - share * (leaves[ray_ids] - enters[ray_ids])
        parts.append(np.unique(_keys(eye[:2] + along[:, None] * rays[ray_ids, :2], resolution)))
    return np.concatenate(parts)


def _chunks(counts: Keys) -> Iterator[NDArray[np.intp]]:
    """Splits the rows of `counts` into chunks of about a million samples."""
    if len(counts):
        pieces = np.cumsum(counts) // _SAMPLES_AT_ONCE
        yield from np.split(np.arange(len(counts)), np.flatnonzero(np.diff(pieces)) + 1)


def _keys(places: F64, resolution: float) -> Keys:
    """Integer keys of the cells of places [P, 2], int64 [K]; unreachable places are dropped."""
    steps = np.floor(places / resolution)
    steps = steps[(np.abs(steps) < REACH - 8).all(axis=1)].astype(np.int64) + REACH
    return np.asarray(steps[:, 0] << 21 | steps[:, 1])


def _steps(keys: Keys) -> tuple[Keys, Keys]:
    """Decodes keys into columns and rows, counted from the frame's origin."""
    return (keys >> 21) - REACH, (keys & ((1 << 21) - 1)) - REACH
