"""The benchmark's scene: Gaussians on the points of Mip-NeRF 360 "garden", or a made scene of their statistics.

The points are those of gsplat's test asset `test_garden.npz` (138,766 points, view 0 of 3); where a data folder does
not hold it, the made scene stands in.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from fastsplat.service.splatting.raster.image_formation import Splats
from fastsplat_contract.geometry.camera import Camera

OPACITY = 0.1

# Statistics of garden's view 0 with 100,000 of its points (widths with other numbers too): where Gaussians fall on the
# image, how deep they lie, and how wide they are on it. `python -m benchmarks.raster.garden` prints them from the data.
IN_VIEW, BEHIND = 0.54, 0.13
"""Shares of all Gaussians; the others lie in front of the camera beside its view."""
ROW_SHARES = (0.020, 0.057, 0.111, 0.241, 0.185, 0.197, 0.128, 0.061)
"""Of the Gaussians in view, in eight bands of the image from top to bottom."""
COLUMN_SHARES = (0.056, 0.096, 0.151, 0.229, 0.198, 0.137, 0.075, 0.058)
"""From left to right."""
DEPTH_LEVELS = (0.05, 0.25, 0.5, 0.75, 0.95)
DEPTHS = (
    (2.99, 3.33, 3.58, 3.90, 5.59),
    (1.05, 3.11, 3.35, 3.58, 3.85),
    (1.07, 2.62, 2.95, 3.37, 3.72),
    (1.00, 1.20, 2.33, 2.72, 3.18),
    (0.89, 1.74, 1.87, 2.07, 2.32),
    (1.26, 1.35, 1.45, 1.55, 1.65),
    (1.00, 1.06, 1.11, 1.18, 1.24),
    (0.84, 0.87, 0.92, 0.96, 0.99),
)
"""Quantiles of the depth in each band of rows, scene units."""
WIDTH_LEVELS = (0, 0.01, 0.05, 0.25, 0.5, 0.75, 0.9, 0.95, 0.99, 0.997, 0.999, 0.9997, 1)
WIDTHS = {
    10_000: (0.96, 2.29, 3.29, 5.36, 7.17, 9.69, 12.58, 14.98, 23.23, 34.07, 95.03, 143.78, 163.21),
    20_000: (0.39, 1.55, 2.34, 3.76, 5.13, 6.99, 9.28, 10.97, 16.18, 23.08, 32.05, 80.23, 137.83),
    100_000: (0.09, 0.46, 0.86, 1.68, 2.39, 3.32, 4.46, 5.43, 8.77, 13.68, 21.71, 35.34, 136.07),
    1_000_000: (0.09, 0.53, 0.76, 1.15, 1.51, 2.01, 2.65, 3.15, 4.49, 5.73, 7.01, 8.55, 21.08),
}
"""By number of Gaussians: quantiles of a Gaussian's standard deviation in pixels of an image of 640 columns."""
FOCAL_IN_WIDTHS, FOCAL_IN_HEIGHTS = 480.61234 / 648, 481.54453 / 420
CENTER = (324.1875 / 648, 210.0625 / 420)


@dataclass(frozen=True)
class Scene:
    """Gaussians and one camera, float32.

    Attributes:
        source: "garden", or "made" of its statistics.
    """

    splats: Splats
    viewmat: Tensor
    camera: Camera
    source: str = "made"


def garden(count: int, width: int, height: int, channels: int) -> Scene:
    """`count` Gaussians of garden where $FASTSPLAT_TEST_DATA holds it, else of the made scene.

    Scales from the three nearest neighbors, random rotations, opacity 0.1 and random features, as a training starts.
    """
    file = garden_file()
    if file is None:
        return made_garden(count, width, height, channels)
    return _garden_of(file, count, width, height, channels)


def garden_file() -> Path | None:
    """$FASTSPLAT_TEST_DATA/garden/test_garden.npz, None where it is not."""
    folder = os.environ.get("FASTSPLAT_TEST_DATA", "")
    path = Path(folder) / "garden" / "test_garden.npz"
    return path if folder and path.is_file() else None


def made_garden(count: int, width: int, height: int, channels: int) -> Scene:
    """`count` Gaussians that are distributed over image, depth and size as garden's are; camera at the origin."""
    random = np.random.default_rng(0)
    camera = _camera(width, height)
    column, row, depth = _in_view(round(IN_VIEW * count), random)
    behind = round(BEHIND * count)
    beside = count - len(depth) - behind
    side = np.where(random.random(beside) < 0.5, -1, 1) * random.uniform(0.5, 2.0, beside)
    column = np.concatenate([column, 0.5 + side, random.random(behind)])
    row = np.concatenate([row, random.random(beside), random.random(behind)])
    z = np.concatenate([depth, random.choice(depth, beside), -random.choice(depth, behind)])
    x, y = (column * width - camera.cx) / camera.fx * z, (row * height - camera.cy) / camera.fy * z
    sigma = _widths(count, random) / (640 * FOCAL_IN_WIDTHS) * np.abs(z)
    return _scene(np.stack([x, y, z], axis=1), sigma, np.eye(4, dtype=np.float32), camera, channels, random, "made")


def _in_view(count: int, random: np.random.Generator) -> tuple[NDArray[np.float64], ...]:
    """Column and row as shares of the image, and depth."""
    rows, columns = (
        random.choice(8, count, p=np.array(shares) / sum(shares)) for shares in (ROW_SHARES, COLUMN_SHARES)
    )
    level = random.random(count)
    depth = np.empty(count)
    for band, quantiles in enumerate(DEPTHS):
        depth[rows == band] = np.interp(level[rows == band], DEPTH_LEVELS, quantiles)
    return (columns + random.random(count)) / 8, (rows + random.random(count)) / 8, depth


def _widths(count: int, random: np.random.Generator) -> NDArray[np.float64]:
    """[count] pixels of 640 columns; between the numbers of Gaussians of the table, logarithms are interpolated."""
    table = np.log(np.array(list(WIDTHS.values())))
    quantiles = [np.interp(np.log(count), np.log(list(WIDTHS)), column) for column in table.T]
    return np.asarray(np.exp(np.interp(random.random(count), WIDTH_LEVELS, quantiles)))


def _garden_of(file: Path, count: int, width: int, height: int, channels: int) -> Scene:
    """Points drawn without replacement (with, and jittered, beyond the file's 138,766)."""
    data = np.load(file)
    random = np.random.default_rng(0)
    points = data["means3d"].astype(np.float64)
    if count <= len(points):
        points = points[random.permutation(len(points))[:count]]
    else:
        more = points[random.integers(0, len(points), count - len(points))]
        points = np.concatenate((points, more + random.normal(0.0, 0.01, more.shape)))
    distances = cKDTree(points).query(points, k=4, workers=2)[0][:, 1:]
    sigma = np.sqrt((distances**2).mean(axis=1)).clip(1e-7)
    return _scene(points, sigma, data["viewmats"][0], _camera(width, height), channels, random, "garden")


def _camera(width: int, height: int) -> Camera:
    return Camera(
        width,
        height,
        FOCAL_IN_WIDTHS * width,
        FOCAL_IN_HEIGHTS * height,
        CENTER[0] * width,
        CENTER[1] * height,
    )


def _scene(
    points: NDArray[np.float64],
    sigma: NDArray[np.float64],
    viewmat: NDArray[np.float32],
    camera: Camera,
    channels: int,
    random: np.random.Generator,
    source: str,
) -> Scene:
    count = len(points)
    splats = Splats(
        means=_tensor(points),
        quats=_tensor(random.normal(size=(count, 4))),
        scales=_tensor(np.repeat(sigma[:, None], 3, axis=1)),
        opacities=torch.full((count,), OPACITY),
        features=_tensor(random.random((count, channels))),
    )
    return Scene(splats, torch.tensor(viewmat), camera, source)


def _tensor(array: NDArray[np.floating]) -> Tensor:
    return torch.tensor(np.ascontiguousarray(array), dtype=torch.float32)


def _print_statistics() -> None:
    """The constants above, of the data."""
    for count in WIDTHS:
        scene = garden(count, 640, 480, 1)
        camera, matrix = scene.camera, scene.viewmat.numpy().astype(np.float64)
        x, y, z = (scene.splats.means.numpy().astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3]).T
        column, row = (camera.fx * x / z + camera.cx) / 640, (camera.fy * y / z + camera.cy) / 480
        visible = (z > 0.01) & (column >= 0) & (column < 1) & (row >= 0) & (row < 1)
        print(f"{scene.source}, {count}: in view {visible.mean():.3f}, behind {(z <= 0.01).mean():.3f}")
        for name, share in (("rows", row), ("columns", column)):
            print(name, (np.bincount((8 * share[visible]).astype(int), minlength=8) / visible.sum()).round(3).tolist())
        band = (8 * row[visible]).astype(int)
        for number in range(8):
            print("depths", number, np.quantile(z[visible][band == number], DEPTH_LEVELS).round(2).tolist())
        widths = scene.splats.scales.numpy()[visible, 0] / z[visible] * camera.fx
        print("widths", np.quantile(widths, WIDTH_LEVELS).round(2).tolist())


if __name__ == "__main__":
    _print_statistics()
