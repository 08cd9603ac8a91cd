"""Similarity transforms: application to points and cameras, least-squares fits."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.geometry.viewpoint import WORLD

F64 = NDArray[np.float64]


@dataclass(frozen=True)
class Similarity:
    """Similarity transform x' = scale · R x + t."""

    scale: float  # positive
    rotation: F64  # [3, 3]
    translation: F64  # [3]
    frame_id: str = WORLD  # name of the frame of x'

    def points(self, points: NDArray[np.floating[Any]]) -> F64:
        """Transforms points [K, 3]."""
        return np.asarray(self.scale * points.astype(np.float64) @ self.rotation.T + self.translation)

    def inverse(self) -> Similarity:
        turn = self.rotation.T
        return Similarity(1 / self.scale, turn, -(turn @ self.translation) / self.scale)

    def after(self, first: Similarity) -> Similarity:
        """Composes: applies `first`, then this one."""
        return Similarity(
            self.scale * first.scale,
            self.rotation @ first.rotation,
            self.scale * self.rotation @ first.translation + self.translation,
            self.frame_id,
        )

    def camera(self, posed: PosedCamera) -> PosedCamera:
        """Moves a camera into the other frame."""
        pose = posed.world_from_camera.copy()
        pose[:3, 3] = self.points(pose[None, :3, 3])[0]
        pose[:3, :3] = self.rotation @ pose[:3, :3]
        return replace(posed, world_from_camera=pose, frame_id=self.frame_id)


def fit_similarity(source: F64, target: F64, *, scaled: bool = True) -> Similarity:
    """Fits a similarity without reflection to points [N, 3], N ≥ 3, not collinear.

    Umeyama, "Least-squares estimation of transformation parameters between two point patterns", PAMI 1991.
    """
    middle, there = source.mean(axis=0), target.mean(axis=0)
    left, values, right = np.linalg.svd((target - there).T @ (source - middle))
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    rotation = left @ np.diag(signs) @ right
    scale = float(values @ signs / ((source - middle) ** 2).sum()) if scaled else 1.0
    return Similarity(scale, rotation, there - scale * rotation @ middle)


def nearest_rotation(matrix: F64) -> F64:
    """Returns the nearest orthogonal matrix, e.g. to a rotation rounded in a file."""
    left, _, right = np.linalg.svd(matrix)
    return np.asarray(left @ right)


def scaled_camera(posed: PosedCamera, factor: float) -> PosedCamera:
    """Multiplies a camera's position by `factor`."""
    pose = posed.world_from_camera.copy()
    pose[:3, 3] *= factor
    return replace(posed, world_from_camera=pose)
