"""`fastsplat objects`: go through the versions of a scene."""

from __future__ import annotations

from typing import Annotated

import typer

from fastsplat.cli.options import SceneId, service_command
from fastsplat.cli.scenes.object_commands import objects_app
from fastsplat.cli.session import Session
from fastsplat.cli.short_ids import SHORT
from fastsplat.cli.tables import Column, minute, table
from fastsplat_contract.messages.scenes import SceneVersion, VersionList

_Only = Annotated[str, typer.Option("--version", help="Only if this is the current version.")]


@service_command(objects_app)
def versions(session: Session, scene: SceneId) -> None:
    """Show every version of a scene, oldest first; a star marks the current one."""
    scene_versions = session.client.versions(session.scene(scene))
    columns = (
        Column(""), Column("version"), Column("made of"), Column("edits", "cut"), Column("by", "cut"), Column("made"),
    )  # fmt: skip
    rows = [
        (
            "*" if version.current else "",
            version.version[:SHORT],
            version.parent[:SHORT],
            ", ".join(edit.action for edit in version.edits) or "trained",
            version.author,
            minute(version.created_at),
        )
        for version in scene_versions
    ]
    session.tell(VersionList(scene_versions), table(columns, rows))


@service_command(objects_app)
def undo(session: Session, scene: SceneId, only: _Only = "") -> None:
    """Go back to the version before the current one."""
    scene_id = session.scene(scene)
    _tell(session, session.client.undo_edit(scene_id, session.version(scene_id, only)))


@service_command(objects_app)
def redo(session: Session, scene: SceneId, only: _Only = "") -> None:
    """Go forward to the version that was undone."""
    scene_id = session.scene(scene)
    _tell(session, session.client.redo_edit(scene_id, session.version(scene_id, only)))


@service_command(objects_app)
def restore(
    session: Session, scene: SceneId, version: Annotated[str, typer.Argument(help="A version of the list of versions.")]
) -> None:
    """Make any version current; all others stay."""
    scene_id = session.scene(scene)
    _tell(session, session.client.restore_version(scene_id, session.version(scene_id, version)))


def _tell(session: Session, version: SceneVersion) -> None:
    session.tell(version, f"version {version.version} is current")
