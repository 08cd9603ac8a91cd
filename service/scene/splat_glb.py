"""Gaussians as glTF: a primitive of points with the Khronos extension KHR_gaussian_splatting for every thing.

The extension is a release candidate; its attributes are linear scales, opacities 0..1, unit quaternions x y z w, and
spherical harmonics with the signs of 3DGS files (with the Condon-Shortley phase).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.common.cancellation import check_cancelled
from fastsplat.service.scene.glb import GlbBuilder, add_camera_nodes, linear, upright
from fastsplat.service.scene.types import SH_C0, Gaussians
from fastsplat_contract.camera import PosedCamera

EXTENSION = "KHR_gaussian_splatting"


@dataclass(frozen=True)
class NamedRows:
    """A node of a file.

    Attributes:
        name: for people.
        extras: what programs are told of it, JSON-ready.
        rows: int64 [K], K ≥ 1: its Gaussians, vertices or faces.
    """

    name: str
    extras: dict[str, Any]
    rows: NDArray[np.int64]


@dataclass(frozen=True)
class GlbScene:
    """What a file says beside its shapes.

    Attributes:
        name: of the scene.
        extras: of the scene, JSON-ready.
        up: float64 [3], the unit vector up of the world frame, which the file's root turns to +y; None if unknown.
        cameras: of the scene.
    """

    name: str
    extras: dict[str, Any]
    up: NDArray[np.float64] | None
    cameras: Sequence[PosedCamera]


def splat_glb(gaussians: Gaussians, groups: Sequence[NamedRows], about: GlbScene) -> bytes:
    """A GLB with a node for each group; within it the Gaussians keep their order. Programs without the extension show
    points in the constant color.

    Args:
        gaussians: of a scene.
        groups: which of them each node has.
        about: the rest.

    Raises:
        LimitExceededError: larger than a GLB can be.
    """
    builder = GlbBuilder("FAST-Splat scene service")
    builder.document["extensionsUsed"] = [EXTENSION]
    nodes = []
    for group in groups:
        check_cancelled()
        primitive = {
            "mode": 0,
            "attributes": _attributes(builder, gaussians, group.rows),
            "extensions": {
                EXTENSION: {
                    "kernel": "ellipse",
                    "colorSpace": "srgb_rec709_display",
                    "projection": "perspective",
                    "sortingMethod": "cameraDistance",
                }
            },
        }
        mesh = builder.add("meshes", {"name": group.name, "primitives": [primitive]})
        nodes.append(builder.add("nodes", {"name": group.name, "mesh": mesh, "extras": group.extras}))
    return finished(builder, nodes, about)


def finished(builder: GlbBuilder, nodes: list[int], about: GlbScene) -> bytes:
    """The file of a document whose shapes are complete: their nodes and the cameras under one root, which is upright.

    Raises:
        LimitExceededError: larger than a GLB can be.
    """
    root: dict[str, Any] = {"name": about.name or "scene", "extras": about.extras}
    if children := nodes + add_camera_nodes(builder, about.cameras):
        root["children"] = children
    if (rotation := upright(about.up)) is not None:
        root["rotation"] = rotation
    builder.document["scene"] = builder.add("scenes", {"nodes": [builder.add("nodes", root)]})
    return builder.file()


def _attributes(builder: GlbBuilder, gaussians: Gaussians, rows: NDArray[np.int64]) -> dict[str, int]:
    quats = gaussians.quats[rows].astype(np.float64)
    quats /= np.maximum(np.linalg.norm(quats, axis=1, keepdims=True), 1e-30)
    opacities = 1 / (1 + np.exp(-gaussians.logit_opacities[rows].astype(np.float64)))
    sh = np.ascontiguousarray(gaussians.sh[rows])
    colors = linear(sh[:, 0] * SH_C0 + 0.5)
    alpha = np.rint(opacities * 65_535).astype(np.uint16)
    attributes = {
        "POSITION": builder.accessor(gaussians.means[rows], bounds=True),
        "COLOR_0": builder.accessor(np.concatenate([colors, alpha[:, None]], axis=1), normalized=True),
        f"{EXTENSION}:ROTATION": builder.accessor(np.asarray(quats[:, [1, 2, 3, 0]], np.float32)),
        f"{EXTENSION}:SCALE": builder.accessor(np.exp(gaussians.log_scales[rows])),
        f"{EXTENSION}:OPACITY": builder.accessor(np.asarray(opacities, np.float32)),
    }
    for degree in range(gaussians.sh_degree + 1):
        for number in range(2 * degree + 1):
            attributes[f"{EXTENSION}:SH_DEGREE_{degree}_COEF_{number}"] = builder.accessor(
                sh[:, degree * degree + number]
            )
    return attributes
