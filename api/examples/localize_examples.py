"""Examples of localizing photos, for the OpenAPI document."""

from __future__ import annotations

import json
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

import numpy as np

from fastsplat_contract.codec.json_codec import to_plain
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from fastsplat_contract.geometry.object_prompts import PixelBox
from fastsplat_contract.geometry.poses import Box, Pose, Quaternion, Vector3
from fastsplat_contract.photos.localization import (
    Localization,
    LocalizedPhoto,
    ObjectInView,
    PhotoDifference,
    SceneChange,
)
from fastsplat_contract.photos.observations import Observation, ObservationList, ObservedPhoto

_ROUGH = (
    Pose(Vector3(0.0, 0.0, 0.0), Quaternion(0.0, 0.0, 0.0, 1.0)),
    Pose(Vector3(0.5, 0.0, 0.0), Quaternion(0.0, 0.0, 0.0, 1.0)),
)
_COVARIANCE = np.diag([4e-6, 4e-6, 9e-6, 1e-6, 1e-6, 1e-6])

LOCALIZE_FORM: Mapping[str, Any] = {
    "photos": ["hall-left.jpg", "hall-right.jpg"],
    "focals": [3024.0],
    "poses": [json.dumps(to_plain(pose)) for pose in _ROUGH],
}
"""Form with two photos (named only) from one camera, half a scene unit apart."""

OBSERVE_FORM: Mapping[str, Any] = {**LOCALIZE_FORM, "seen_at": "2026-11-23T18:00:00+01:00", "request_id": "monday"}
"""Form with two photos of another day."""

LOCALIZATION = Localization(
    photos=(
        LocalizedPhoto(
            refusal=None,
            explanation="214 places of the photo agree with the pose, and the scene's picture agrees by 0.81 of 1.",
            camera=PosedCamera(Camera(4032, 3024, 3024.0, 3024.0, 2016.0, 1512.0), np.eye(4)),
            radial=0.0,
            covariance=tuple(_COVARIANCE.ravel().tolist()),
            focal_source="given",
            inliers=214,
            inlier_share=0.71,
            spread=0.62,
            agreement=0.81,
            refined=True,
            objects=(ObjectInView(2, "ball", 0.043, PixelBox(1690.0, 1310.0, 2310.0, 1930.0)),),
            differences=(PhotoDifference("new", PixelBox(310.0, 1840.0, 820.0, 2410.0), 0.97),),
        ),
        LocalizedPhoto(
            refusal="few_matches",
            explanation="Only 7 places of the photo were found together in the scene, fewer than 15: it shows another "
            "place, or this one from where no photo of the scene was taken.",
            camera=None,
            radial=0.0,
            covariance=(),
            focal_source=None,
            inliers=7,
            inlier_share=0.12,
            spread=0.01,
            agreement=None,
            refined=False,
            objects=(),
            differences=(),
        ),
    ),
    changes=(
        SceneChange(
            kind="moved",
            object_id=2,
            name="ball",
            probability=0.97,
            distance=0.42,
            before=Box(Pose(Vector3(0.1, 0.2, 0.1), Quaternion(0.0, 0.0, 0.0, 1.0)), Vector3(0.2, 0.2, 0.2)),
            after=Box(Pose(Vector3(0.52, 0.2, 0.1), Quaternion(0.0, 0.0, 0.0, 1.0)), Vector3(0.2, 0.2, 0.2)),
            photos=(0, 1),
            sentence='The "ball" has moved by 0.42 m.',
        ),
    ),
    looked_at=(1, 2),
    meters=True,
    version="1",
)

_CAMERA = PosedCamera(Camera(4032, 3024, 3024.0, 3024.0, 2016.0, 1512.0), np.eye(4))
OBSERVATION = Observation(
    scene_id="5b0c9f2e7d1a4b38a6e1c0d94f7b2a35",
    id="e5b0c9f2e7d1a4b38",
    seen_at=datetime(2026, 11, 23, 17, 0, tzinfo=UTC),
    seen_at_source="given",
    photos=tuple(ObservedPhoto(f"e5b0c9f2e7d1a4b38/{number}", _CAMERA, ()) for number in range(2)),
    left_out=(),
    changes=LOCALIZATION.changes,
    looked_at=(1, 2),
    meters=True,
    sentence=LOCALIZATION.changes[0].sentence,
)
OBSERVATIONS = ObservationList((OBSERVATION,), "", "e5b0c9f2e7d1a4b38")
