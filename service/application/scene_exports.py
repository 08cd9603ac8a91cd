"""Scenes as files for other programs."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.application.cache import LeastRecentlyUsed
from fastsplat.service.application.geometry_files import (
    cameras_file,
    mesh_file,
    points_file,
    splats_file,
    surface_bytes,
)
from fastsplat.service.application.mask_encodings import mask_ply
from fastsplat.service.application.memory import MemoryBudget, export_bytes
from fastsplat.service.application.open_scenes import OpenScenes
from fastsplat.service.application.scene_page import scene_page
from fastsplat.service.query import SceneIndex
from fastsplat.service.scene import Gaussians
from fastsplat.service.scene.spz_writing import spz_bytes
from fastsplat.service.store import Store
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.exports import ExportFormat, ExportRequest

MEDIA_TYPES: Mapping[ExportFormat, str] = {
    "ply": "application/x-ply",
    "spz": "application/octet-stream",
    "html": "text/html",
    "points": "application/x-ply",
    "glb": "model/gltf-binary",
    "mesh": "model/gltf-binary",
    "cameras": "application/zip",
}
"""Of each format, as HTTP names it."""

_WITH_CELLS: tuple[ExportFormat, ...] = ("points", "mesh", "cameras")

_CACHED_BYTES = 128 << 20


class Exports:
    """Files of finished scenes. Every method is safe from any thread.

    Whole scenes as SPZ are kept in memory: every visit of the page asks for one, and making it costs seconds for a
    million Gaussians.
    """

    def __init__(self, store: Store, scenes: OpenScenes, memory: MemoryBudget) -> None:
        self._store = store
        self._scenes = scenes
        self._memory = memory
        self._splats: LeastRecentlyUsed[tuple[str, str], bytes] = LeastRecentlyUsed(_CACHED_BYTES)

    def over(self, store: Store, scenes: OpenScenes) -> Exports:
        """The same memory, with the scenes of another view of the store."""
        other = copy.copy(self)
        other._store = store
        other._scenes = scenes
        return other

    def forget(self, scene_id: str) -> None:
        """Let go of one scene."""
        self._splats.drop(lambda key: key[0] == scene_id)

    def file(self, request: ExportRequest) -> bytes:
        """The file that is asked for.

        Raises:
            NotFoundError: unknown scene, version or thing; the viewer of single files is not built.
            InvalidInputError: some things alone in a format that holds whole scenes, a cell that is none or for a
                format without cells, surfaces of a scene without cameras.
            LimitExceededError: more points or voxels than the settings allow, or as `Answers.query`.
            NotReadyError: as `Answers.query`.
        """
        _check_cell(request)
        write = _WRITERS[request.format]
        return self._scenes.reading(
            request.scene_id, request.version, lambda index, version: write(self, index, version, request)
        )

    def _spz(self, index: SceneIndex, version: str, request: ExportRequest) -> bytes:
        def make() -> bytes:
            gaussians = _rows(index.scene.gaussians, thing_rows(index, request.things))
            with self._memory.reserve(export_bytes(gaussians), "scene_id"):
                return spz_bytes(gaussians)

        if request.things:
            return make()
        size = 32 * len(index.scene.gaussians)
        return self._splats.get((request.scene_id, version), lambda: size, make)

    def _ply(self, index: SceneIndex, version: str, request: ExportRequest) -> bytes:
        gaussians = index.scene.gaussians
        with self._memory.reserve(export_bytes(gaussians), "scene_id"):
            every = np.ones(len(gaussians), np.bool_)
            rows = thing_rows(index, request.things)
            return mask_ply(gaussians, every if rows is None else rows)

    def _html(self, index: SceneIndex, version: str, request: ExportRequest) -> bytes:
        if request.things:
            raise InvalidInputError(
                "a page of some things alone", field="things", hint="Ask for the whole scene, or for another format."
            )
        name = self._name(request)
        spz = self._spz(index, version, request)
        with self._memory.reserve(export_bytes(index.scene.gaussians), "scene_id"):
            return scene_page(index, name, spz)

    def _points(self, index: SceneIndex, version: str, request: ExportRequest) -> bytes:
        with self._memory.reserve(surface_bytes(index, mesh=False), "scene_id"):
            return points_file(index, self._name(request), request.things, request.cell)

    def _cameras(self, index: SceneIndex, version: str, request: ExportRequest) -> bytes:
        with self._memory.reserve(surface_bytes(index, mesh=False), "scene_id"):
            return cameras_file(index, self._name(request), request.things, request.cell)

    def _mesh(self, index: SceneIndex, version: str, request: ExportRequest) -> bytes:
        with self._memory.reserve(surface_bytes(index, mesh=True), "scene_id"):
            return mesh_file(index, self._name(request), request.things, request.cell)

    def _glb(self, index: SceneIndex, version: str, request: ExportRequest) -> bytes:
        with self._memory.reserve(export_bytes(index.scene.gaussians), "scene_id"):
            return splats_file(index, self._name(request), request.things)

    def _name(self, request: ExportRequest) -> str:
        return self._store.scenes.scene(request.scene_id).name


_WRITERS: Mapping[ExportFormat, Callable[[Exports, SceneIndex, str, ExportRequest], bytes]] = {
    "ply": Exports._ply,
    "spz": Exports._spz,
    "html": Exports._html,
    "points": Exports._points,
    "glb": Exports._glb,
    "mesh": Exports._mesh,
    "cameras": Exports._cameras,
}


def _check_cell(request: ExportRequest) -> None:
    if not (math.isfinite(request.cell) and request.cell >= 0):
        raise InvalidInputError(f"a cell of {request.cell}", field="cell", hint="Scene units, above 0.")
    if request.cell and request.format not in _WITH_CELLS:
        raise InvalidInputError(
            f'the format "{request.format}" has no cells', field="cell", hint=f"For {', '.join(_WITH_CELLS)} alone."
        )


def thing_rows(index: SceneIndex, things: Sequence[int]) -> NDArray[np.bool_] | None:
    """bool [G]: the Gaussians of these things or parts; None without any.

    Raises:
        NotFoundError: the scene has no thing of one of these ids.
    """
    if not things:
        return None
    own = [index.things.get(thing_id) for thing_id in dict.fromkeys(things)]
    rows = np.isin(index.things.owner, [thing.id for thing in own if not thing.parent])
    parts = [thing.id for thing in own if thing.parent]
    return np.asarray(rows | np.isin(index.things.part_owner, parts) if parts else rows)


def _rows(gaussians: Gaussians, rows: NDArray[np.bool_] | None) -> Gaussians:
    if rows is None:
        return gaussians
    return replace(gaussians, **{name: array[rows] for name, array in vars(gaussians).items()})
