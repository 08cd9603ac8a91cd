"""The benchmark's scene: points of Mip-NeRF 360 "garden", any number of them, at any resolution."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from fastsplat.service.splatting.raster import Splats
from fastsplat_contract.camera import Camera

OPACITY = 0.1


@dataclass(frozen=True)
class Scene:
    """Gaussians and one camera, float32."""

    splats: Splats
    viewmat: Tensor
    camera: Camera


def garden_file() -> Path:
    """$FASTSPLAT_TEST_DATA/garden/test_garden.npz."""
    folder = os.environ.get("FASTSPLAT_TEST_DATA", "")
    path = Path(folder) / "garden" / "test_garden.npz"
    if not folder or not path.is_file():
        raise SystemExit(f"FASTSPLAT_TEST_DATA={folder!r} holds no garden/test_garden.npz")
    return path


def garden(count: int, width: int, height: int, channels: int) -> Scene:
    """`count` points drawn without replacement (with, and jittered, beyond the file's 138,766).

    Scales from the three nearest neighbours, random rotations, opacity 0.1, random features.
    """
    data = np.load(garden_file())
    random = np.random.default_rng(0)
    points = data["means3d"].astype(np.float64)
    if count <= len(points):
        points = points[random.permutation(len(points))[:count]]
    else:
        more = points[random.integers(0, len(points), count - len(points))]
        points = np.concatenate((points, more + random.normal(0.0, 0.01, more.shape)))
    distances = cKDTree(points).query(points, k=4, workers=2)[0][:, 1:]
    scales = np.sqrt((distances**2).mean(axis=1)).clip(1e-7)
    intrinsics = data["Ks"][0]
    sx, sy = width / int(data["width"]), height / int(data["height"])
    camera = Camera(
        width,
        height,
        float(intrinsics[0, 0] * sx),
        float(intrinsics[1, 1] * sy),
        float(intrinsics[0, 2] * sx),
        float(intrinsics[1, 2] * sy),
    )
    splats = Splats(
        means=_tensor(points),
        quats=_tensor(random.normal(size=(count, 4))),
        scales=_tensor(np.repeat(scales[:, None], 3, axis=1)),
        opacities=torch.full((count,), OPACITY),
        features=_tensor(random.random((count, channels))),
    )
    return Scene(splats, torch.tensor(data["viewmats"][0]), camera)


def _tensor(array: np.ndarray) -> Tensor:
    return torch.tensor(np.ascontiguousarray(array), dtype=torch.float32)
