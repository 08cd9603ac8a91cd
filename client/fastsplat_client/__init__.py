"""A typed client of the scene service, for robots and scripts.

    from pathlib import Path
    from fastsplat_client import Client

    with Client("https://robots.example:8000", key="...") as client:
        operation = client.wait(client.create_scene(Path("photos/")).id)
        (answer,) = client.query(operation.scene_id, "mug", views=["0001.jpg"], outputs=["mask2d", "objects"])
        mask = answer.masks[0].array()  # bool [H, W]

Types and errors are those of `fastsplat_contract`; this package exports the common ones.
"""

from fastsplat_client.client import Client
from fastsplat_client.errors import RemoteError, UnreachableError
from fastsplat_client.job_calls import Placed
from fastsplat_client.keys import share_link
from fastsplat_client.pending_queries import Subscription
from fastsplat_client.releases import ReleaseWarning
from fastsplat_client.stream import PoseAnswer, Reconnect
from fastsplat_client.transport import Retry
from fastsplat_contract.errors import (
    CancelledError,
    ConflictError,
    DeadlineExceededError,
    FastSplatError,
    InvalidInputError,
    Kind,
    LimitExceededError,
    MissingPackageError,
    NotFoundError,
    NotReadyError,
    PermissionDeniedError,
    RateLimitedError,
    UnauthenticatedError,
)
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from fastsplat_contract.geometry.gaussian_filters import GaussianFilter
from fastsplat_contract.geometry.places import Alignment, KnownLength, KnownSize, Place, PointPair
from fastsplat_contract.geometry.poses import Box, Pose, Quaternion, Vector3
from fastsplat_contract.jobs.look_again import FoundName, LookAgainResult
from fastsplat_contract.jobs.name_suggestions import SuggestedName
from fastsplat_contract.jobs.operations import Operation, OperationError, SceneOptions, StageProgress
from fastsplat_contract.masks import Segmentation, ViewMask, decode_mask3d
from fastsplat_contract.messages.assessments import Assessment, Finding
from fastsplat_contract.messages.contact_sheets import ContactSheet, NeighborObject, SheetObject
from fastsplat_contract.messages.detections import Detection, DetectionList, Support
from fastsplat_contract.messages.edit_previews import EditPreview
from fastsplat_contract.messages.goals import Goal
from fastsplat_contract.messages.measurements import Length, LocatedPlace, Measurement
from fastsplat_contract.messages.object_reads import ObjectRead
from fastsplat_contract.messages.objects import NameSuggestion, PickedLevel, PickedObject, SceneObject
from fastsplat_contract.messages.queries import Answer, Match, QueryRequest
from fastsplat_contract.messages.scenes import (
    Color,
    DictionaryEntry,
    Edit,
    InsertSource,
    Scene,
    SceneScaling,
    SceneSummary,
    SceneVersion,
)
from fastsplat_contract.photos.localization import Localization, LocalizedPhoto
from fastsplat_contract.photos.next_photos import NextPhoto
from fastsplat_contract.photos.observations import Observation, ObservedPhoto
from fastsplat_contract.photos.pictures import PictureRequest
from fastsplat_contract.server.keys import AccessKey, NewKey
from fastsplat_contract.server.server_info import ServerInfo

__all__ = [
    "AccessKey", "Alignment", "Answer", "Assessment", "Box", "Camera", "CancelledError", "Client", "Color",
    "ConflictError", "ContactSheet", "DeadlineExceededError", "Detection", "DetectionList", "DictionaryEntry", "Edit",
    "EditPreview", "FastSplatError", "Finding", "FoundName", "GaussianFilter", "Goal", "InsertSource",
    "InvalidInputError", "Kind", "KnownLength", "KnownSize", "Length", "LimitExceededError", "Localization",
    "LocalizedPhoto", "LocatedPlace", "LookAgainResult", "Match", "Measurement", "MissingPackageError",
    "NameSuggestion", "NeighborObject", "NewKey", "NextPhoto", "NotFoundError", "NotReadyError", "ObjectRead",
    "Observation", "ObservedPhoto", "Operation", "OperationError", "PermissionDeniedError", "PickedLevel",
    "PickedObject", "PictureRequest", "Place", "Placed", "PointPair", "Pose", "PoseAnswer", "PosedCamera", "Quaternion",
    "QueryRequest", "RateLimitedError", "Reconnect", "ReleaseWarning", "RemoteError", "Retry", "Scene", "SceneObject",
    "SceneOptions", "SceneScaling", "SceneSummary", "SceneVersion", "Segmentation", "ServerInfo", "SheetObject",
    "StageProgress", "Subscription", "SuggestedName", "Support", "UnauthenticatedError", "UnreachableError", "Vector3",
    "ViewMask", "decode_mask3d", "share_link",
]  # fmt: skip
