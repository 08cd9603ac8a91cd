"""Floor maps as written by nav2's map_server and map_saver."""

from __future__ import annotations

import numpy as np

from fastsplat.service.application.exporting.geometry_files import ViewsOf, surface_bytes
from fastsplat.service.query.objects.floors import floor_ids, names_of_others
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.query.surfaces.occupancy import (
    FREE,
    MAX_MAP_CELLS,
    OCCUPIED,
    RESOLUTION,
    OccupancyMap,
    check_map_frame,
    occupancy_map,
)
from fastsplat.service.query.surfaces.surface_views import surface_views
from fastsplat.service.scene.formats.zips import zipped

_PER_CELL, _PER_SAMPLE = 32, 160
_SAMPLES = 1 << 20

_PIXELS = {FREE: 254, OCCUPIED: 0}
_UNKNOWN_PIXEL = 205
_OCCUPIED_THRESHOLD, _FREE_THRESHOLD = 0.65, 0.196
"""With these, pixel 205 is unknown: (255 − 205) / 255 = 0.19608."""

_FLOOR_WORDS = {"surface": "an object that is a floor", "lowest_level": "the lowest dense level that faces up"}


def map_bytes(index: SceneIndex) -> int:
    """Estimated peak of making a scene's map, in bytes.

    Raises:
        InvalidInputError: the scene has no cameras, or as `check_map_frame`.
    """
    check_map_frame(index.scene)
    grid_bytes = _PER_CELL * MAX_MAP_CELLS + _PER_SAMPLE * _SAMPLES
    return surface_bytes(index, mesh=False) + grid_bytes


def map_of(index: SceneIndex, cell: float = 0.0, views_of: ViewsOf = surface_views) -> OccupancyMap:
    """Occupancy map of a scene's floor; `cell` is in meters, 0: `RESOLUTION`.

    Raises:
        InvalidInputError: the scene has no cameras, is not in meters, or has unknown up; no floor is seen.
        LimitExceededError: too many points or cells.
    """
    check_map_frame(index.scene)
    return occupancy_map(
        views_of(index),
        floor_ids(index.objects.present, index.scene.dictionary),
        names_of_others(index.objects.present, index.scene.dictionary),
        resolution=cell or RESOLUTION,
        height=index.settings.map_height,
    )


def map_file(index: SceneIndex, cell: float, views_of: ViewsOf = surface_views) -> bytes:
    """Zip of `map.pgm` and `map.yaml`; raises as `map_of`."""
    known = map_of(index, cell, views_of)
    return zipped({"map.pgm": _pgm(known), "map.yaml": _yaml(known)})


def _pgm(known: OccupancyMap) -> bytes:
    """Binary PGM; the first row has the largest y."""
    pixels = np.full(known.cells.shape, _UNKNOWN_PIXEL, np.uint8)
    for value, pixel in _PIXELS.items():
        pixels[known.cells == value] = pixel
    height, width = known.cells.shape
    return f"P5\n{width} {height}\n255\n".encode() + pixels[::-1].tobytes()


def _yaml(known: OccupancyMap) -> bytes:
    x, y = known.origin
    doubt = f"# It may be no floor: {known.floor_doubt}.\n" if known.floor_doubt else ""
    return (
        f"{doubt}# The floor is at z = {known.floor:.3f} m, by {_FLOOR_WORDS[known.floor_source]}; occupied is what "
        f"stands up to {known.height:g} m above it.\n"
        "image: map.pgm\n"
        "mode: trinary\n"
        f"resolution: {known.resolution!r}\n"
        f"origin: [{x!r}, {y!r}, 0.0]\n"
        "negate: 0\n"
        f"occupied_thresh: {_OCCUPIED_THRESHOLD}\n"
        f"free_thresh: {_FREE_THRESHOLD}\n"
    ).encode()
