"""Folders in the layout of LLFF (Mildenhall et al. 2019), as 3D-OVS is published: photos beside `poses_bounds.npy`.

A row of the file is a camera in the order of the photos' names: a matrix [3, 5] by rows, then its nearest and farthest
depth. The matrix' columns are the camera's down, right and backward axes in the world, its position, and height, width
and focal length in pixels (github.com/Fyusion/LLFF, README, "Using your own poses without running COLMAP").
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np

_POSES = "poses_bounds.npy"


def with_transforms(folder: Path, work: Path) -> Path:
    """The folder itself where it needs no conversion, else its copy in `work` with the cameras as transforms.json.

    The photos are those of the first folder `images`, `images_4` and so on that has one for each camera.

    Raises:
        SystemExit: the file holds no finite numbers [V, 17], or no folder has V photos.
    """
    if not (folder / _POSES).is_file() or (folder / "transforms.json").exists() or (folder / "sparse").exists():
        return folder
    try:
        rows = np.load(folder / _POSES, allow_pickle=False).astype(np.float64)
    except ValueError as error:
        raise SystemExit(f"{folder / _POSES} cannot be read: {error}") from error
    if rows.ndim != 2 or rows.shape[1] != 17 or not np.isfinite(rows).all():
        raise SystemExit(f"{folder / _POSES} holds {list(rows.shape)}, and not finite numbers [V, 17]")
    listed = {path: sorted(path.iterdir()) for path in sorted(folder.glob("images*")) if path.is_dir()}
    photos = next((names for names in listed.values() if len(names) == len(rows)), None)
    if photos is None:
        counts = ", ".join(f"{path.name} has {len(names)}" for path, names in listed.items())
        raise SystemExit(f"{folder / _POSES} has {len(rows)} cameras: {counts or 'there is no folder images'}")
    frames = []
    for photo, matrix in zip(photos, rows[:, :15].reshape(-1, 3, 5), strict=True):
        height, width, focal = matrix[:, 4]
        pose = np.eye(4)  # OpenGL axes: right, up, backward
        pose[:3] = np.stack([matrix[:, 1], -matrix[:, 0], matrix[:, 2], matrix[:, 3]], axis=1)
        lens = {"w": int(width), "h": int(height), "fl_x": focal, "fl_y": focal, "cx": width / 2, "cy": height / 2}
        path = photo.relative_to(folder).as_posix()
        frames.append({"file_path": path, "transform_matrix": pose.tolist(), **lens})
    copy = work / folder.name
    shutil.copytree(folder, copy, ignore=shutil.ignore_patterns(*(p.name for p in listed if p != photos[0].parent)))
    (copy / "transforms.json").write_text(json.dumps({"frames": frames}))
    return copy
