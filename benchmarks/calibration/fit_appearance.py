"""Fit the directions of appearance descriptors: `service/perception/appearance_projection.npy`.

    python -m benchmarks.calibration.fit_appearance

Photos are those of the drawn rooms that `draw_rooms` makes, the demo's sample apart. Features of objects are whitened
by their scatter within kinds, shrunk towards the identity, and of the whitened ones the principal components are kept,
so that cosines tell kinds apart. Shrinkage and number of components were chosen on the six validation rooms of
`benchmarks.rooms`, which are not among those of the fit. Row 0 are mean features, the others the directions.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmarks.provenance import parser_of
from fastsplat.service.instances.naming.object_appearances import best_sights, sights_by_view
from fastsplat.service.jobs.looks_rooms import LabeledRoom, drawn_rooms
from fastsplat.service.perception.appearance import (
    PROJECTION_FILE,
    SIZE,
    AppearanceEncoder,
    open_appearance_encoder,
    pooled_features,
)
from fastsplat.service.settings import load_settings

F64 = NDArray[np.float64]

_SHRINKAGE = 0.3


def _main() -> None:
    parser_of(__doc__).parse_args()
    settings = load_settings()
    encoder = open_appearance_encoder(settings.perception, settings.models)
    assert encoder is not None
    kinds, features = [], []
    for room in drawn_rooms():
        if room.kind != "sample":
            for kind, rows in _looked_at(room, encoder):
                kinds.append(kind)
                features.append(rows)
    center = np.mean([rows.mean(axis=0) for rows in features], axis=0)
    pooled = np.stack([pooled_features(list(rows), center) for rows in features])
    np.save(PROJECTION_FILE, np.vstack([center, directions_of(pooled, kinds)]).astype(np.float16))


def _looked_at(room: LabeledRoom, encoder: AppearanceEncoder) -> list[tuple[str, NDArray[np.float32]]]:
    """Kind and features [V, C] of each object of a room, walls and floors apart."""
    sights = best_sights(enumerate(ids for _, ids in room.views), room.labels)
    found: dict[int, list[NDArray[np.float32]]] = {object_id: [] for object_id in sights}
    for view, visible in sights_by_view(sights).items():
        for object_id, sight in visible:
            found[object_id].append(encoder.features(room.views[view][0], sight.mask))
    labeled = [(room.labels[object_id], np.stack(rows)) for object_id, rows in found.items()]
    return [(kind, rows) for kind, rows in labeled if kind not in ("floor", "wall")]


def directions_of(features: F64, kinds: list[str], count: int = SIZE) -> F64:
    """Directions, float64 [count, C], along which features [K, C] differ between kinds more than within them.

    A kind weighs as the root of the number of its objects.
    """
    labels = np.array(kinds)
    rows = []
    for kind in np.unique(labels):
        of_kind = features[labels == kind]
        if len(of_kind) > 1:
            rows.append((of_kind - of_kind.mean(axis=0)) / len(of_kind) ** 0.25)
    within = np.concatenate(rows)
    scatter = within.T @ within
    scatter *= len(scatter) / np.trace(scatter)
    values, vectors = np.linalg.eigh((1 - _SHRINKAGE) * scatter + _SHRINKAGE * np.eye(len(scatter)))
    whitening = vectors / np.sqrt(values) @ vectors.T
    white = features @ whitening
    components = np.linalg.svd(white - white.mean(axis=0), full_matrices=False)[2][:count]
    return np.asarray(components @ whitening)


if __name__ == "__main__":
    _main()
