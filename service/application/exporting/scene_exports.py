"""Export of scenes to files for other programs."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from fastsplat.service.application.answering.mask_encodings import mask_ply
from fastsplat.service.application.answering.photos import size_of
from fastsplat.service.application.answering.project_context import ProjectContext
from fastsplat.service.application.base.cache import BudgetedCache
from fastsplat.service.application.base.memory import export_bytes
from fastsplat.service.application.base.validate import check_texts
from fastsplat.service.application.exporting.camera_files import camera_list, colmap, transforms
from fastsplat.service.application.exporting.geometry_files import (
    ViewsOf,
    cameras_file,
    mesh_file,
    points_file,
    surface_bytes,
)
from fastsplat.service.application.exporting.map_files import map_bytes, map_file, map_of
from fastsplat.service.application.exporting.scene_page import scene_page
from fastsplat.service.application.exporting.scene_recording import SceneRecording, bounded_photos
from fastsplat.service.capture.photos.scene_photos import photo_path
from fastsplat.service.common.cache import LeastRecentlyUsed
from fastsplat.service.common.optional_packages import MCAP, needed
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.query.surfaces.occupancy import OccupancyMap
from fastsplat.service.query.surfaces.surface_views import BYTES_PER_PIXEL, SurfaceView, surface_views
from fastsplat.service.scene.artefact.scene import Gaussians
from fastsplat.service.scene.formats.sog_writing import sog_bytes
from fastsplat.service.scene.formats.spz_writing import spz_bytes
from fastsplat.service.scene.gaussians.scene_rows import gaussians_of_rows
from fastsplat_contract.errors import InvalidInputError, LimitExceededError, NotFoundError, SceneFileError
from fastsplat_contract.messages.exports import FORMATS, ExportFormat, ExportRequest
from fastsplat_contract.messages.goals import Goal

ROBOT_RADIUS = 0.2
"""Default in meters."""

_CACHED_BYTES = 128 << 20


class Exports:
    """Files of finished scenes, and goals on their floor map. Thread-safe.

    Whole scenes as SPZ are cached: every visit of the page asks for one, and making it costs seconds for a million
    Gaussians. So are surface views, the source of points, mesh and cameras.
    """

    def __init__(self, context: ProjectContext) -> None:
        self._context = context
        self._splats: LeastRecentlyUsed[tuple[str, str], bytes] = LeastRecentlyUsed(_CACHED_BYTES)
        query = context.settings.query
        largest = BYTES_PER_PIXEL * query.surface_views * query.surface_side**2
        self._surfaces: BudgetedCache[tuple[str, str], tuple[SurfaceView, ...]] = BudgetedCache(largest, context.memory)

    def over(self, context: ProjectContext) -> Exports:
        """Same caches for another view of the store."""
        clone = copy.copy(self)
        clone._context = context
        return clone

    def forget(self, scene_id: str) -> None:
        """Drops one scene."""
        self._splats.drop(lambda key: key[0] == scene_id)
        self._surfaces.drop(lambda key: key[0] == scene_id)

    def file(self, request: ExportRequest) -> bytes:
        """Writes a scene in the requested format.

        Raises:
            NotFoundError: unknown scene, version or object; the viewer of single files is not built.
            InvalidInputError: options that the format does not support, an invalid cell, surfaces of a scene without
                cameras, a camera name that the format cannot hold, or an invalid version text.
            LimitExceededError: more points or voxels than the settings allow, or as `Answers.query`.
            NotReadyError: as `Answers.query`.
            MissingPackageError: mcap without its package.
            SceneFileError: a stored photo is damaged.
        """
        check_texts(replace(request, scene_id=""))
        _check(request)
        write = _WRITERS[request.format]
        index, version = self._context.scenes.open(request.scene_id, request.version)
        objects = index.objects.with_members(request.object_ids) if request.object_ids else ()
        return write(self, index, version, replace(request, object_ids=objects))

    def goal(self, scene_id: str, object_id: int, robot_radius: float = 0.0, version: str = "") -> Goal:
        """Nearest free place from which a robot sees an object or part, see `goal_near`.

        `robot_radius` is in meters, 0: `ROBOT_RADIUS`.

        Raises:
            NotFoundError: unknown scene, version or object; there is no such place.
            InvalidInputError: the scene is not in meters with z up, or shows no floor; an invalid radius; an object
                without a box.
            LimitExceededError, NotReadyError: as `file`.
        """
        from fastsplat.service.query.surfaces.goals import goal_near  # scipy loads with the first call

        check_texts(version, "version")
        index, read_version = self._context.scenes.open(scene_id, version)
        needed = map_bytes(index)  # refuses a scene without a map
        try:
            obj = index.objects.get(object_id)
        except NotFoundError as error:
            raise NotFoundError(error.message, field="object_id", hint=error.hint) from error
        with self._context.memory.reserve(needed, "scene_id"):
            known = map_of(index, 0.0, self._views_of(scene_id, read_version))
        return goal_near(known, obj, robot_radius or ROBOT_RADIUS, read_version)

    def _spz(self, index: SceneIndex, version: str, request: ExportRequest) -> bytes:
        def make() -> bytes:
            gaussians = index.coarse.scene.gaussians if request.coarse else _of_objects(index, request.object_ids)
            with self._context.memory.reserve(export_bytes(gaussians), "scene_id"):
                return spz_bytes(gaussians)

        if request.object_ids or request.coarse:
            return make()
        size = 32 * len(index.scene.gaussians)
        return self._splats.get((request.scene_id, version), lambda: size, make)

    def _splats_file(
        self, index: SceneIndex, version: str, request: ExportRequest, *, write: Callable[[Gaussians], bytes]
    ) -> bytes:
        gaussians = _of_objects(index, request.object_ids)
        with self._context.memory.reserve(export_bytes(gaussians), "scene_id"):
            return write(gaussians)

    def _ply(self, index: SceneIndex, version: str, request: ExportRequest) -> bytes:
        gaussians = index.scene.gaussians
        with self._context.memory.reserve(export_bytes(gaussians), "scene_id"):
            every = np.ones(len(gaussians), np.bool_)
            return mask_ply(gaussians, index.objects.rows(request.object_ids) if request.object_ids else every)

    def _html(self, index: SceneIndex, version: str, request: ExportRequest) -> bytes:
        name = self._name(request)
        spz = self._spz(index, version, request)
        with self._context.memory.reserve(export_bytes(index.scene.gaussians), "scene_id"):
            return scene_page(index, name, spz)

    def _surface_file(
        self,
        index: SceneIndex,
        version: str,
        request: ExportRequest,
        *,
        write: Callable[[SceneIndex, str, Sequence[int], float, ViewsOf], bytes],
        mesh: bool = False,
    ) -> bytes:
        with self._context.memory.reserve(surface_bytes(index, mesh=mesh), "scene_id"):
            views_of = self._views_of(request.scene_id, version)
            return write(index, self._name(request), request.object_ids, request.cell, views_of)

    def _mcap(self, index: SceneIndex, version: str, request: ExportRequest) -> bytes:
        with needed(MCAP, 'the format "mcap"'):
            from fastsplat.service.application.exporting.foxglove_file import foxglove_file

        files, left_out = self._photo_files(request.scene_id, version, len(index.scene.cameras))
        floor, floor_missing = self._floor(index, version, request)
        versions = self._context.store.versions.of(self._context.store.scenes.scene(request.scene_id))
        record = next((record for record in versions if record.version == version), None)
        if record is None:
            raise NotFoundError(f"version {version!r} was removed meanwhile", field="version")
        created_ns = round(record.created_at * 1000) * 10**6
        with self._context.memory.reserve(surface_bytes(index, mesh=False) + 3 * sum(files.values()), "scene_id"):
            name, views = self._name(request), self._views_of(request.scene_id, version)
            points = points_file(index, name, request.object_ids, request.cell, views)
            photos = self._photo_contents(request.scene_id, version, files)
            recording = SceneRecording(
                request.scene_id, version, name, created_ns, points, photos, left_out, floor, floor_missing
            )
            return foxglove_file(index, recording, request.object_ids)

    def _floor(self, index: SceneIndex, version: str, request: ExportRequest) -> tuple[OccupancyMap | None, str]:
        """Floor map, or the reason for its absence."""
        if request.object_ids:
            return None, "a map is of a whole scene"
        try:
            needed_bytes = map_bytes(index)
        except InvalidInputError as error:
            return None, error.message
        with self._context.memory.reserve(needed_bytes, "scene_id"):
            try:
                return map_of(index, 0.0, self._views_of(request.scene_id, version)), ""
            except (InvalidInputError, LimitExceededError) as error:
                return None, error.message

    def _photo_files(self, scene_id: str, version: str, cameras: int) -> tuple[dict[int, int], int]:
        """Bytes of photos to include, by camera number, and the number left out."""
        folder = self._context.scenes.folder(scene_id, version)
        sizes = {number: size for number in range(cameras) if (size := size_of(photo_path(folder, number)))}
        photos = {number: sizes[number] for number in bounded_photos(sizes)}
        return photos, len(sizes) - len(photos)

    def _photo_contents(self, scene_id: str, version: str, numbers: Iterable[int]) -> dict[int, bytes]:
        """Verified JPEG files by camera number."""
        folder = self._context.scenes.folder(scene_id, version)
        paths = {number: photo_path(folder, number) for number in numbers}
        try:
            if paths:
                names = [path.relative_to(folder).as_posix() for path in paths.values()]
                self._context.store.blobs.check_version(folder, *names)
            return {number: path.read_bytes() for number, path in paths.items()}
        except (FileNotFoundError, SceneFileError) as error:
            if folder.is_dir():
                raise
            raise NotFoundError(f"scene {scene_id!r} was deleted meanwhile", field="scene") from error

    def _map(self, index: SceneIndex, version: str, request: ExportRequest) -> bytes:
        with self._context.memory.reserve(map_bytes(index), "scene_id"):
            return map_file(index, request.cell, self._views_of(request.scene_id, version))

    def _views_of(self, scene_id: str, version: str) -> ViewsOf:
        def views(index: SceneIndex) -> tuple[SurfaceView, ...]:
            held = self._surfaces.get((scene_id, version), lambda: self._surfaces.budget, lambda: surface_views(index))
            self._surfaces.count()
            return held

        return views

    def _name(self, request: ExportRequest) -> str:
        return self._context.store.scenes.scene(request.scene_id).name


_WRITERS: Mapping[ExportFormat, Callable[[Exports, SceneIndex, str, ExportRequest], bytes]] = {
    "ply": Exports._ply,
    "spz": Exports._spz,
    "spz4": partial(Exports._splats_file, write=partial(spz_bytes, version=4)),
    "html": Exports._html,
    "points": partial(Exports._surface_file, write=points_file),
    "mesh": partial(Exports._surface_file, write=mesh_file, mesh=True),
    "cameras": partial(Exports._surface_file, write=cameras_file),
    "sog": partial(Exports._splats_file, write=sog_bytes),
    "mcap": Exports._mcap,
    "map": Exports._map,
    "camera_list": lambda exports, index, version, request: camera_list(index.scene.cameras),
    "transforms": lambda exports, index, version, request: transforms(index.scene.cameras),
    "colmap": lambda exports, index, version, request: colmap(index.scene.cameras),
    "objects": lambda exports, index, version, request: index.objects.owner.astype("<u2").tobytes(),
}


def _check(request: ExportRequest) -> None:
    facts = FORMATS[request.format]
    if request.object_ids and facts.whole:
        raise InvalidInputError(
            f"{facts.whole} of some objects alone",
            field="object_ids",
            hint="Ask for the whole scene, or for another format.",
        )
    if not (math.isfinite(request.cell) and request.cell >= 0):
        raise InvalidInputError(f"a cell of {request.cell}", field="cell", hint="Scene units, above 0.")
    if request.cell and not facts.cell:
        raise InvalidInputError(
            f'the format "{request.format}" has no cells',
            field="cell",
            hint=f"For {', '.join(name for name in FORMATS if FORMATS[name].cell)} alone.",
        )
    if request.coarse and (request.format != "spz" or request.object_ids):
        raise InvalidInputError(
            f"a coarse file of {'some objects' if request.object_ids else request.format}",
            field="coarse",
            hint='It is for "spz", and for whole scenes.',
        )


def _of_objects(index: SceneIndex, objects: Sequence[int]) -> Gaussians:
    """Gaussians of these objects or parts; all if empty."""
    gaussians = index.scene.gaussians
    if not objects:
        return gaussians
    return gaussians_of_rows(gaussians, index.objects.rows(objects))
