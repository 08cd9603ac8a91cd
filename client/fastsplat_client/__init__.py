"""A typed client of the scene service, for robots and scripts.

    from pathlib import Path
    from fastsplat_client import Client

    with Client("https://robots.example:8000", key="...") as client:
        operation = client.wait(client.create_scene(Path("photos/")).id)
        (answer,) = client.query(operation.scene_id, "mug", views=["0001.jpg"], outputs=["mask2d", "objects"])
        mask = answer.masks[0].array()  # bool [H, W]

It speaks the contract's own types and raises the contract's own errors, as the service does in process. The most used
ones are here; all of them are in `fastsplat_contract`.
"""

from fastsplat_client.client import Client
from fastsplat_client.errors import RemoteError, UnreachableError
from fastsplat_client.job_calls import Placed
from fastsplat_client.keys import share_link
from fastsplat_client.pending_queries import StandingQuestion
from fastsplat_client.releases import ReleaseWarning
from fastsplat_client.stream import PoseAnswer, Reconnect
from fastsplat_client.transport import Retry
from fastsplat_contract.assessments import Assessment, Finding
from fastsplat_contract.camera import Camera, PosedCamera
from fastsplat_contract.detection_messages import Detection, DetectionList, Support
from fastsplat_contract.edit_previews import EditPreview
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
from fastsplat_contract.gaussian_filters import GaussianFilter
from fastsplat_contract.goal_messages import Goal
from fastsplat_contract.keys import AccessKey, NewKey
from fastsplat_contract.localize_messages import Localization, LocalizedPhoto
from fastsplat_contract.look_again_messages import FoundName, LookAgainResult
from fastsplat_contract.masks import Segmentation, ViewMask, decode_mask3d
from fastsplat_contract.measure_messages import Length, LocatedPlace, Measurement
from fastsplat_contract.name_suggestions import SuggestedName
from fastsplat_contract.next_photo_messages import NextPhoto
from fastsplat_contract.observation_messages import Observation, ObservedPhoto
from fastsplat_contract.operations import Operation, OperationError, SceneOptions, StageProgress
from fastsplat_contract.pictures import PictureRequest
from fastsplat_contract.places import Alignment, KnownLength, KnownSize, Place, PointPair
from fastsplat_contract.poses import Box, Pose, Quaternion, Vector3
from fastsplat_contract.queries import Answer, Match, QueryRequest
from fastsplat_contract.scenes import (
    Color,
    DictionaryEntry,
    Edit,
    InsertSource,
    Scene,
    SceneScaling,
    SceneSummary,
    SceneVersion,
)
from fastsplat_contract.server_info import ServerInfo
from fastsplat_contract.thing_messages import NameSuggestion, PickedLevel, PickedThing, SceneThing
from fastsplat_contract.thing_reads import ThingRead
from fastsplat_contract.thing_sheets import NeighborThing, SheetThing, ThingSheet

__all__ = [
    "AccessKey",
    "Alignment",
    "Answer",
    "Assessment",
    "Box",
    "Camera",
    "CancelledError",
    "Client",
    "Color",
    "ConflictError",
    "DeadlineExceededError",
    "Detection",
    "DetectionList",
    "DictionaryEntry",
    "Edit",
    "EditPreview",
    "FastSplatError",
    "Finding",
    "FoundName",
    "GaussianFilter",
    "Goal",
    "InsertSource",
    "InvalidInputError",
    "Kind",
    "KnownLength",
    "KnownSize",
    "Length",
    "LimitExceededError",
    "Localization",
    "LocalizedPhoto",
    "LocatedPlace",
    "LookAgainResult",
    "Match",
    "Measurement",
    "MissingPackageError",
    "NameSuggestion",
    "NeighborThing",
    "NewKey",
    "NextPhoto",
    "NotFoundError",
    "NotReadyError",
    "Observation",
    "ObservedPhoto",
    "Operation",
    "OperationError",
    "PermissionDeniedError",
    "PickedLevel",
    "PickedThing",
    "PictureRequest",
    "Place",
    "Placed",
    "PointPair",
    "Pose",
    "PoseAnswer",
    "PosedCamera",
    "Quaternion",
    "QueryRequest",
    "RateLimitedError",
    "Reconnect",
    "ReleaseWarning",
    "RemoteError",
    "Retry",
    "Scene",
    "SceneOptions",
    "SceneScaling",
    "SceneSummary",
    "SceneThing",
    "SceneVersion",
    "Segmentation",
    "ServerInfo",
    "SheetThing",
    "StageProgress",
    "StandingQuestion",
    "SuggestedName",
    "Support",
    "ThingRead",
    "ThingSheet",
    "UnauthenticatedError",
    "UnreachableError",
    "Vector3",
    "ViewMask",
    "decode_mask3d",
    "share_link",
]
