"""A typed client of the scene service, for robots and scripts.

    from pathlib import Path
    from fastsplat_client import Client

    with Client("https://robots.example:8000", key="...") as client:
        operation = client.wait(client.create_scene(Path("photos/")).id)
        (answer,) = client.query(operation.scene_id, "mug", views=["0001.jpg"], outputs=["mask2d", "objects"])
        mask = answer.masks[0].array()  # bool [H, W]

It speaks the service's own types and raises the service's own errors (`service.calls.types`,
`fastsplat_contract.errors`), so that code reads the same in process and over the wire.
"""

from fastsplat_client.client import Client
from fastsplat_client.errors import DeadlineExceededError, RemoteError, UnreachableError
from fastsplat_client.stream import PoseAnswer, StandingQuestion
from fastsplat_client.transport import Retry

__all__ = [
    "Client",
    "DeadlineExceededError",
    "PoseAnswer",
    "RemoteError",
    "Retry",
    "StandingQuestion",
    "UnreachableError",
]
