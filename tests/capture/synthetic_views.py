"""Features and perfect matches of synthetic images, in a database of COLMAP's."""

from __future__ import annotations

from pathlib import Path

import pycolmap


def synthesize_views(database: Path, images: int, points: int = 150, *, cameras: int = 1) -> pycolmap.Reconstruction:
    """Write them, of so many cameras; returns the truth."""
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_cameras_per_rig, options.num_frames_per_rig = cameras, 1, images // cameras
    options.num_points3D, options.inlier_match_ratio = points, 1.0
    pycolmap.set_random_seed(0)
    with pycolmap.Database.open(database) as writer:
        return pycolmap.synthesize_dataset(options, writer)
