"""Connected Gaussians: exactly those that the definition connects."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse.csgraph import connected_components
from scipy.spatial.transform import Rotation

from fastsplat.service.scene.artefact.scene import Gaussians
from fastsplat.service.scene.gaussians.connectivity import components


def scattered(count: int, seed: int) -> Gaussians:
    """Gaussians of very different sizes and shapes, some without a rotation, each in a cell of its own."""
    rng = np.random.default_rng(seed)
    lattice = np.stack(np.unravel_index(rng.choice(6**3, count, replace=False), (6, 6, 6)), axis=1)
    quats = rng.normal(size=(count, 4)).astype(np.float32)
    quats[::7] = 0
    return Gaussians(
        means=(lattice**1.7 + rng.uniform(-0.2, 0.2, (count, 3))).astype(np.float32),
        quats=quats,
        log_scales=rng.normal(-1.6, 0.8, (count, 3)).astype(np.float32),
        logit_opacities=np.zeros(count, np.float32),
        sh=np.zeros((count, 1, 3), np.float32),
        codes=np.zeros((count, 0), np.float32),
    )


def touching(gaussians: Gaussians) -> np.ndarray:
    """The components by the definition: the shapes of every pair of neighbors are looked at."""
    means, count = gaussians.means.astype(np.float64), len(gaussians)
    scales = np.exp(gaussians.log_scales.astype(np.float64))
    scales = np.minimum(scales, 4 * np.median(scales.max(axis=1)))
    turns = [Rotation.from_quat(q[[1, 2, 3, 0]]).as_matrix() if q.any() else np.eye(3) for q in gaussians.quats]
    distance = np.linalg.norm(means[:, None] - means, axis=2)
    order = np.argsort(distance, axis=1)
    spacing = np.median(distance[np.arange(count), order[:, 1]])
    edges = np.zeros((count, count), np.bool_)
    for row in range(count):
        for neighbor in order[row, 1:9]:
            towards = (means[neighbor] - means[row]) / distance[row, neighbor]
            reach = sum(np.linalg.norm((towards @ turns[end]) * scales[end]) for end in (row, neighbor))
            edges[row, neighbor] = distance[row, neighbor] <= max(reach, 2 * spacing)
    return np.asarray(connected_components(edges, directed=False)[1])


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("count", [2, 3, 9, 40, 120])
def test_components_are_those_of_the_definition(count: int, seed: int) -> None:
    gaussians = scattered(count, seed)
    whole, expected = components(gaussians, np.arange(count)), touching(gaussians)
    np.testing.assert_array_equal(whole[:, None] == whole, expected[:, None] == expected)
