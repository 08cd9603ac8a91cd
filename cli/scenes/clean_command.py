"""`fastsplat scenes clean`: removes Gaussians by a box, opacity, isolation or object."""

from __future__ import annotations

from typing import Annotated

import typer

from fastsplat.cli.options import SceneId, service_command
from fastsplat.cli.scenes.scene_commands import scenes_app
from fastsplat.cli.session import Session
from fastsplat_contract.geometry.gaussian_filters import GaussianFilter
from fastsplat_contract.geometry.poses import Box, Pose, Quaternion, Vector3
from fastsplat_contract.messages.scenes import Edit

_Three = tuple[float, float, float]


@service_command(scenes_app)
def clean(
    session: Session,
    scene: SceneId,
    center: Annotated[_Three | None, typer.Option(help="x y z of the middle of a box; with --size.")] = None,
    size: Annotated[_Three | None, typer.Option(help="Edge lengths x y z of the box, scene units.")] = None,
    outside: Annotated[bool, typer.Option(help="Remove what lies outside of the box, not what lies in it.")] = False,
    opacity_below: Annotated[float | None, typer.Option(help="Only what is less opaque than this, 0 to 1.")] = None,
    isolation_above: Annotated[
        float | None, typer.Option(help="Only what is so many times farther from others than usual; 4 is a start.")
    ] = None,
    obj: Annotated[
        list[int], typer.Option("--object", help="Only of this object, by its id; several are allowed.")
    ] = [],
    preview: Annotated[bool, typer.Option(help="Only say how much would go.")] = False,
) -> None:
    """Remove Gaussians in or outside a box, faint ones, or floating ones, as a version."""
    box = None
    if center is not None or size is not None:
        middle = Pose(Vector3(*(center or (0.0, 0.0, 0.0))), Quaternion(0.0, 0.0, 0.0, 1.0))
        box = Box(middle, Vector3(*(size or (0.0, 0.0, 0.0))))
    chosen = GaussianFilter(box, outside, opacity_below, isolation_above)
    edits = [Edit("remove", object_ids=tuple(obj), filter=chosen)]
    scene_id = session.scene(scene)
    if preview:
        edit_preview = session.client.preview_edit(scene_id, edits)
        session.tell(edit_preview, f"{edit_preview.count:,} of {edit_preview.gaussians:,} Gaussians would go")
        return
    new_version = session.client.edit_scene(scene_id, edits)
    session.tell(new_version, f"version {new_version.version} is current, with {new_version.gaussians:,} Gaussians")
