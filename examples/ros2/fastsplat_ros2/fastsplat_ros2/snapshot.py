"""One version of a scene with all that is published of it, read by the light client."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime

from fastsplat_client import Client, DetectionList, InvalidInputError, NotFoundError, Scene
from fastsplat_ros2.messages import check_meters, whole


@dataclass(frozen=True)
class Snapshot:
    """A version of a scene.

    Attributes:
        scene: as it is.
        detections: all of its objects.
        points: the export `points`, a PLY.
        floor_map: the export `map`, a zip; None where the scene has none.
        no_map: why it has none, in the server's words; "" where it has.
        stamp_ns: when the version was made, nanoseconds since 1970: a scene has no other clock.
    """

    scene: Scene
    detections: DetectionList
    points: bytes
    floor_map: bytes | None
    no_map: str
    stamp_ns: int


def read_snapshot(client: Client, scene_id: str) -> Snapshot:
    """The current version of a scene.

    Raises:
        InvalidInputError: the scene is not in meters.
        FastSplatError: whatever else the server refuses.
    """
    scene = client.scene(scene_id)
    check_meters(scene.scale == "METRIC")
    floor_map, no_map = None, ""
    try:
        floor_map = client.export(scene_id, "map", version=scene.version)
    except InvalidInputError as error:  # nothing tells what is up, or no photo shows a floor
        no_map = f"{error.message}. {error.hint}"
    return Snapshot(
        scene=scene,
        detections=whole(_pages(client, scene_id, scene.version)),
        points=client.export(scene_id, "points", version=scene.version),
        floor_map=floor_map,
        no_map=no_map,
        stamp_ns=_nanoseconds(_made_at(client, scene_id, scene.version)),
    )


def _pages(client: Client, scene_id: str, version: str) -> Iterator[DetectionList]:
    token = ""
    while True:
        page = client.detection_page(scene_id, version=version, page_token=token)
        yield page
        if not (token := page.next_page_token):
            return


def _made_at(client: Client, scene_id: str, version: str) -> datetime:
    for candidate in client.versions(scene_id):
        if candidate.version == version:
            return candidate.created_at
    raise NotFoundError(f"version {version!r} was removed meanwhile", field="version", hint="Read the scene again.")


def _nanoseconds(moment: datetime) -> int:
    return round(moment.timestamp() * 1e6) * 1000
