"""Passes thinned COLMAP snapshots from the mapping child to its parent, which distrusts them."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from zipfile import BadZipFile, ZipFile

import numpy as np

from fastsplat.service.capture.sfm.geometry import normalize_world
from fastsplat.service.capture.sfm.placed_cameras import MAX_CAMERAS, MAX_POINTS, PlacedViews, evenly, thinned
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.geometry.camera import Camera, PosedCamera

_FILE = "placed.npz"
_SNAPSHOTS = 8  # about, per capture; each costs the mapper a write and a read of its model
_FEWEST_IMAGES = 4
_MAX_BYTES = 4 << 20


def frames_between(images: int) -> int:
    """Computes the number of images between snapshots."""
    return max(_FEWEST_IMAGES, -(-images // _SNAPSHOTS))


def keep_newest(snapshots: Path, folder: Path, read: Any) -> None:
    """Keeps the newest of COLMAP's snapshot folders in `snapshots`, if any, and removes them all."""
    models = sorted(snapshots.iterdir())
    if not models:
        return
    model = read(models[-1])
    for path in models:
        shutil.rmtree(path)
    keep(model, folder)


def keep(model: Any, folder: Path) -> None:
    """Stores a thinned copy of a `pycolmap.Reconstruction` in the task's folder for `take_placed`."""
    images = [image for image in model.images.values() if image.has_pose]
    images = [images[row] for row in evenly(len(images), MAX_CAMERAS)]
    ids = list(model.points3D.keys())
    points = [model.points3D[ids[row]] for row in evenly(len(ids), MAX_POINTS)]
    cameras = [image.camera for image in images]
    part = folder / f"part-{_FILE}"
    np.savez(
        part,
        names=np.array([image.name for image in images]),
        poses=np.array([image.cam_from_world().inverse().matrix() for image in images]).reshape(-1, 3, 4),
        pinholes=np.array(
            [[c.width, c.height, c.mean_focal_length(), c.principal_point_x, c.principal_point_y] for c in cameras]
        ).reshape(-1, 5),
        points=np.array([point.xyz for point in points]).reshape(-1, 3),
        colors=np.array([point.color for point in points], dtype=np.uint8).reshape(-1, 3),
        placed=np.array(model.num_reg_images()),
    )
    part.rename(folder / _FILE)


def take_placed(folder: Path, names: Mapping[str, str], images: int) -> PlacedViews | None:
    """Takes new valid cameras, if any, in a normalized upright world; `names` by file."""
    path, mine = folder / _FILE, folder / f"read-{_FILE}"
    try:
        path.rename(mine)
        with ZipFile(mine) as archive:
            if sum(entry.file_size for entry in archive.infolist()) > _MAX_BYTES:
                return None
        with np.load(mine, allow_pickle=False) as arrays:
            return _placed(arrays, names, images)
    except (OSError, EOFError, ValueError, TypeError, KeyError, MemoryError, BadZipFile, InvalidInputError):
        return None


def _placed(arrays: Mapping[str, Any], names: Mapping[str, str], images: int) -> PlacedViews | None:
    poses = np.tile(np.eye(4), (len(arrays["poses"]), 1, 1))
    poses[:, :3] = arrays["poses"]
    points = np.asarray(arrays["points"], dtype=np.float64)
    colors = np.asarray(arrays["colors"], dtype=np.uint8)
    if len(poses) < 2 or not len(points) or points.shape != colors.shape or points.shape[1:] != (3,):
        return None
    poses, points = normalize_world(poses, points)
    if not (np.isfinite(poses).all() and np.isfinite(points).all()):
        return None
    files: Sequence[str] = [str(name) for name in arrays["names"]]
    cameras = [
        PosedCamera(Camera(int(width), int(height), focal, focal, cx, cy), pose, names[file])
        for file, pose, (width, height, focal, cx, cy) in zip(files, poses, arrays["pinholes"].tolist(), strict=True)
    ]
    placed = min(max(int(arrays["placed"]), len(cameras)), images)
    return thinned(cameras, points, colors, images, placed=placed, complete=False)
