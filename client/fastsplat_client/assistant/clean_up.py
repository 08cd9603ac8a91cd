"""Gaussians that an assistant counts or removes for a user."""

from __future__ import annotations

from fastsplat_client.assistant.tool_results import CleanedUp
from fastsplat_client.assistant.tools import resolve_scene
from fastsplat_client.client import Client
from fastsplat_contract.geometry.gaussian_filters import GaussianFilter
from fastsplat_contract.geometry.poses import Box, Pose, Quaternion, Vector3
from fastsplat_contract.messages.scenes import Edit

_Three = tuple[float, float, float]


def clean_up(
    client: Client,
    corners: tuple[_Three, _Three] | None,
    outside: bool,
    opacity_below: float | None,
    isolation_above: float | None,
    objects: list[int],
    remove: bool,
    scene: str,
) -> CleanedUp:
    """How many Gaussians fulfil all that is said; with `remove` a version without them."""
    scene_info = resolve_scene(client, scene)
    box = None
    if corners is not None:
        low, high = corners
        middle = Vector3(*((a + b) / 2 for a, b in zip(low, high, strict=True)))
        size = Vector3(*(b - a for a, b in zip(low, high, strict=True)))
        box = Box(Pose(middle, Quaternion(0.0, 0.0, 0.0, 1.0)), size)
    chosen = GaussianFilter(box, outside, opacity_below, isolation_above)
    edits = [Edit("remove", object_ids=tuple(objects), filter=chosen)]
    preview = client.preview_edit(scene_info.id, edits, version=scene_info.version)
    version = client.edit_scene(scene_info.id, edits, looked_at=preview.version).version if remove else ""
    return CleanedUp(scene_info.id, preview.gaussians, preview.count, version)
