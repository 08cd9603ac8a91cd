"""Exports labelled triangle meshes as glTF with a node per object and unlit colors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.common.cancellation import check_cancelled
from fastsplat.service.scene.artefact.scene import F32
from fastsplat.service.scene.formats.glb import ELEMENT_ARRAY_BUFFER, GlbBuilder, GlbScene, NamedRows, finished, linear

_UNLIT = "KHR_materials_unlit"


def mesh_glb(
    points: F32,  # [V, 3], scene units
    normals: F32,  # [V, 3], unit length or zero
    colors: NDArray[np.uint8],  # [V, 3], sRGB
    labels: NDArray[np.uint16],  # [V]
    confidence: F32,  # [V]
    faces: NDArray[np.int64],  # [F, 3], counter-clockwise seen from outside
    groups: Sequence[NamedRows],  # rows are faces
    about: GlbScene,
) -> bytes:
    """Builds a GLB with a node per group of faces.

    Vertices have `POSITION`, `NORMAL`, `COLOR_0`, `_LABEL` (dictionary id) and `_CONFIDENCE` (0..1). The material is
    unlit because the colors hold the light of the photos.

    Raises:
        LimitExceededError: the file would be larger than a GLB can be.
    """
    builder = GlbBuilder("FAST-Splat scene service")
    nodes = []
    if groups:
        builder.document["extensionsUsed"] = [_UNLIT]
        builder.add("materials", {"name": "photos", "extensions": {_UNLIT: {}}, "doubleSided": True})
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    unit = np.where(lengths > 0.5, normals / np.maximum(lengths, 1e-9), np.array([0, 1, 0], np.float32))
    for group in groups:
        check_cancelled()
        rows, corners = np.unique(faces[group.rows], return_inverse=True)
        attributes = {
            "POSITION": builder.accessor(points[rows], bounds=True),
            "NORMAL": builder.accessor(np.asarray(unit[rows], np.float32)),
            "COLOR_0": builder.accessor(linear(colors[rows] / 255), normalized=True),
            "_LABEL": builder.accessor(labels[rows]),
            "_CONFIDENCE": builder.accessor(confidence[rows]),
        }
        indices = builder.accessor(corners.reshape(-1).astype(np.uint32), target=ELEMENT_ARRAY_BUFFER)
        primitive = {"attributes": attributes, "indices": indices, "material": 0}
        mesh = builder.add("meshes", {"name": group.name, "primitives": [primitive]})
        nodes.append(builder.add("nodes", {"name": group.name, "mesh": mesh, "extras": group.extras}))
    return finished(builder, nodes, about)
