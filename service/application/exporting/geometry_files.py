"""Files of a scene's points and meshes, with named objects."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.application.exporting.camera_files import transforms
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.query.surfaces.surface_mesh import surface_mesh
from fastsplat.service.query.surfaces.surface_points import MAX_SURFACE_POINTS, surface_points
from fastsplat.service.query.surfaces.surface_views import BYTES_PER_PIXEL, SurfaceView, surface_cameras, surface_views
from fastsplat.service.scene.artefact.scene import Object
from fastsplat.service.scene.formats.colmap_writing import colmap_model
from fastsplat.service.scene.formats.glb import GlbScene, NamedRows, mesh_glb
from fastsplat.service.scene.formats.point_ply import point_ply, point_rows
from fastsplat.service.scene.formats.zips import zipped
from fastsplat_contract.errors import InvalidInputError

ViewsOf = Callable[[SceneIndex], tuple[SurfaceView, ...]]

REST = "unassigned"
"""Node name of elements outside all objects."""

_PER_GAUSSIAN, _PER_PIXEL, _PER_POINT, _PER_VOXEL = 768, 160, 200, 100


def surface_bytes(index: SceneIndex, *, mesh: bool) -> int:
    """Estimated peak of extracting surfaces, optionally meshed, in bytes.

    Raises:
        InvalidInputError: the scene has no cameras.
    """
    pixels = [
        posed.camera.width * posed.camera.height for posed in surface_cameras(index.scene.cameras, index.settings)
    ]
    return (
        _PER_GAUSSIAN * len(index.scene.gaussians)
        + _PER_PIXEL * max(pixels)
        + (BYTES_PER_PIXEL + 12) * sum(pixels)
        + _PER_POINT * MAX_SURFACE_POINTS
        + (_PER_VOXEL * index.settings.max_surface_voxels if mesh else 0)
    )


def points_file(
    index: SceneIndex, name: str, objects: Sequence[int], cell: float, views_of: ViewsOf = surface_views
) -> bytes:
    """Labelled surface points, see `point_ply` and `surface_points`.

    Args:
        objects: only these; empty: all.
        cell: point distance in scene units; 0: the views' resolution.

    Raises:
        NotFoundError: no such object.
        InvalidInputError: a part, or a scene without cameras.
        LimitExceededError: too many points.
    """
    _check_whole(index, objects)
    samples, width = surface_points(views_of(index), cell=cell)
    if objects:
        samples = samples.where(np.isin(samples.objects, list(objects)))
    labels = {number: entry.label for number, entry in enumerate(index.scene.dictionary.entries, 1)}
    return point_ply(
        samples.points,
        samples.normals,
        samples.colors,
        samples.labels,
        samples.objects,
        samples.confidence,
        {
            "scene": name,
            "units": _units(index),
            "cell": width,
            "label": labels,
            "object": {obj.id: obj.name for obj in _objects(index, objects)},
        },
    )


def mesh_file(
    index: SceneIndex, name: str, objects: Sequence[int], cell: float, views_of: ViewsOf = surface_views
) -> bytes:
    """GLB triangle mesh with a node per object, see `mesh_glb` and `surface_mesh`.

    `cell` is the voxel width. Arguments and errors otherwise as `points_file`; voxels are limited, too.
    """
    _check_whole(index, objects)
    most = index.settings.max_surface_voxels
    mesh = surface_mesh(
        views_of(index), cell=cell, most_voxels=most, limit=f"{most} voxels (FASTSPLAT_QUERY__MAX_SURFACE_VOXELS)"
    )
    seen = mesh.vertices
    described = about(index, name, index.scene.cameras)
    described.extras["voxel"] = mesh.voxel
    groups = nodes_of(index, mesh.objects, objects)
    return mesh_glb(seen.points, seen.normals, seen.colors, seen.labels, seen.confidence, mesh.faces, groups, described)


def cameras_file(
    index: SceneIndex, name: str, objects: Sequence[int], cell: float, views_of: ViewsOf = surface_views
) -> bytes:
    """Zip of cameras and points for nerfstudio and COLMAP; arguments and errors as `points_file`.

    `transforms.json` (with `ply_file_path`), `points.ply`, and COLMAP's binary model with the same points in
    `sparse/0/`. All cameras are included.
    """
    cameras = index.scene.cameras
    points = points_file(index, name, objects, cell, views_of)
    rows = point_rows(points)
    positions = np.stack([rows[axis] for axis in "xyz"], axis=1)
    colors = np.stack([rows[channel] for channel in ("red", "green", "blue")], axis=1)
    model = colmap_model(cameras, positions, colors)
    return zipped(
        {
            "transforms.json": transforms(cameras, ply_file_path="points.ply"),
            "points.ply": points,
            **{f"sparse/0/{file}": content for file, content in model.items()},
        }
    )


def nodes_of(index: SceneIndex, owner: NDArray[np.integer], objects: Sequence[int]) -> list[NamedRows]:
    """A node per object, by id, then one for unassigned elements unless `objects` are given.

    `owner` [K] is the object of each element, 0 for none.
    """
    nodes = []
    for obj in _objects(index, objects):
        rows = np.flatnonzero(owner == obj.id)
        if len(rows):
            label_id = index.scene.dictionary.id_of(obj.name) if obj.name else None
            extras: dict[str, Any] = {"object": obj.id, "name": obj.name, "probability": obj.probability}
            extras |= {"label": label_id or 0, "surface": obj.surface}
            nodes.append(NamedRows(obj.name or f"object {obj.id}", extras, rows))
    if not objects and len(rest := np.flatnonzero(~np.isin(owner, [obj.id for obj in index.objects.present]))):
        nodes.append(NamedRows(REST, {"object": 0}, rest))
    return nodes


def about(index: SceneIndex, name: str, cameras: Sequence[Any]) -> GlbScene:
    """Scene metadata of a GLB."""
    up = index.scene.up()
    extras = {"units": _units(index), "upright": up is not None}
    return GlbScene(name, extras, up, tuple(cameras))


def _units(index: SceneIndex) -> str:
    return "metres" if index.scene.scale == "METRIC" else "arbitrary"


def _objects(index: SceneIndex, objects: Sequence[int]) -> list[Object]:
    return [obj for obj in index.objects.present if not objects or obj.id in objects]


def _check_whole(index: SceneIndex, objects: Sequence[int]) -> None:
    index.objects.check_all(objects)
    whole = {obj.id for obj in index.objects.present}
    for number, object_id in enumerate(objects):
        if object_id not in whole:
            raise InvalidInputError(
                f"object {object_id} is a part of another one",
                field=f"object_ids[{number}]",
                hint="Parts alone are exported as ply, spz or sog.",
            )
