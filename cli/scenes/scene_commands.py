"""`fastsplat scenes`: list, show, rename, align and delete scenes, and list their photos."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Annotated

import typer

from fastsplat.cli.options import SceneId, Version, service_command
from fastsplat.cli.session import Session
from fastsplat.cli.short_ids import SHORT
from fastsplat.cli.tables import Column, facts, minute, table
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.geometry.places import Alignment, PointPair
from fastsplat_contract.geometry.poses import Vector3
from fastsplat_contract.messages.scenes import Scene, SceneList
from fastsplat_contract.photos.next_photos import NextPhotoList
from fastsplat_contract.photos.photo_verdicts import PhotoVerdict, PhotoVerdictList

scenes_app = typer.Typer(
    help="Scenes: list, show, create, rename, delete, export them; their photos, their place.", no_args_is_help=True
)

_SHOWN_NAMES = 60


@service_command(scenes_app, "list")
def list_scenes(session: Session) -> None:
    """Show all scenes, newest first."""
    scenes = tuple(session.client.scenes())
    columns = (
        Column("scene"), Column("name", "cut"), Column("state"), Column("Gaussians", right=True),
        Column("objects", right=True), Column("unit"), Column("photos of"),
    )  # fmt: skip
    rows = [
        (
            scene.id[:SHORT],
            scene.name,
            scene.state,
            f"{scene.gaussians:,}",
            "-" if scene.object_count is None else str(scene.object_count),
            "m" if scene.scale == "METRIC" else "-",
            minute(scene.captured_at or scene.created_at),
        )
        for scene in scenes
    ]
    session.tell(SceneList(scenes, ""), table(columns, rows), nothing="there is no scene")


@service_command(scenes_app)
def show(session: Session, scene: SceneId) -> None:
    """Show a scene's state, quality, unit and names."""
    scene_info = session.client.scene(session.scene(scene))
    session.tell(scene_info, scene_facts(scene_info))


@service_command(scenes_app)
def sample(session: Session) -> None:
    """Copy the server's sample scene into the project, unless it is there."""
    opened = session.client.open_sample()
    session.tell(opened, scene_facts(opened))


@service_command(scenes_app)
def rename(
    session: Session,
    scene: SceneId,
    name: Annotated[str, typer.Argument(metavar="NAME", help="Its new name; it need not be unique.")],
) -> None:
    """Give a scene another name."""
    renamed = session.client.rename_scene(session.scene(scene), name)
    session.tell(renamed, f"scene {renamed.id} is called {renamed.name!r}")


@service_command(scenes_app)
def delete(
    session: Session,
    scene: SceneId,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask whether you are sure.")] = False,
) -> None:
    """Delete a scene with all its files and versions, for ever; its job stops."""
    scene_id = session.scene(scene)
    if not yes:
        name = session.client.scene(scene_id).name
        typer.confirm(f"Delete scene {scene_id}, {name!r}, for ever?", abort=True, err=True)
    session.client.delete_scene(scene_id)
    session.tell(None, f"scene {scene_id} is deleted")


@service_command(scenes_app)
def photos(session: Session, scene: SceneId) -> None:
    """Show what became of each photo of a scene, and what to do about it."""
    verdicts = tuple(session.client.photo_verdicts(session.scene(scene)))
    placed = sum(verdict.placed for verdict in verdicts)
    columns = (Column("photo", "wrap"), Column("verdict", "wrap"), Column("advice", "wrap"))
    session.tell(
        PhotoVerdictList(verdicts, "", bool(verdicts), placed, len(verdicts)),
        table(columns, [(verdict.name, _verdict(verdict), verdict.advice) for verdict in verdicts]),
        nothing="nobody has looked at the photos of this scene: see the job",
    )
    if verdicts:
        typer.echo(f"{placed} of {len(verdicts)} photos have a place", err=True)


@service_command(scenes_app, "next-photos")
def next_photos(session: Session, scene: SceneId, version: Version = "") -> None:
    """Say where to stand for the next photos of a scene."""
    scene_id = session.scene(scene)
    version = session.version(scene_id, version) or session.current(scene_id)
    places = session.client.next_photos(scene_id, version)
    session.tell(
        NextPhotoList(places, version),
        "\n".join(place.advice for place in places),
        nothing="no place to stand at would add much",
    )


@service_command(scenes_app)
def align(
    session: Session,
    scene: SceneId,
    pairs: Annotated[
        Path, typer.Argument(help="CSV file of pairs: x,y,z of the scene, then x,y,z of the map in meters.")
    ],
    frame: Annotated[str, typer.Option(help="Name of the map's frame.")] = "map",
) -> None:
    """Align a scene with a map by three or more points, as a new version."""
    alignment = Alignment(frame, pairs=_pairs(pairs))
    scene_id = session.scene(scene)
    new_version = session.client.align_scene(scene_id, alignment)
    result = session.client.scene(scene_id).alignment
    assert result is not None and result.rms is not None
    lines = [f"the pairs fit to {result.rms:.4g} m (root mean square)", f"version {new_version.version} is current"]
    session.tell(new_version, "\n".join(lines))
    for number in result.outliers:
        typer.echo(f"pair {number + 1} did not count: it is {result.residuals[number]:.4g} m off", err=True)


def scene_facts(scene: Scene) -> str:
    """What is known of a scene, for people."""
    names = Counter({entry.label: entry.gaussian_count for entry in scene.dictionary}).most_common(_SHOWN_NAMES)
    more = scene.label_count - len(names)
    assessment = scene.assessment
    findings = () if assessment is None else assessment.findings
    return facts(
        (
            ("scene", scene.id),
            ("name", scene.name),
            ("state", scene.state),
            ("version", scene.version),
            ("job", scene.operation_id),
            ("made", minute(scene.created_at)),
            ("size", f"{scene.gaussians:,} Gaussians, {scene.camera_count} cameras" if scene.gaussians else ""),
            ("unit", _unit(scene) if scene.gaussians else ""),
            ("quality", "" if assessment is None else assessment.grade),
            *(("", f"{finding.message} {finding.advice}") for finding in findings),
            ("names", ", ".join(name for name, _ in names) + (f" and {more} more" if more > 0 else "")),
        )
    )


def _unit(scene: Scene) -> str:
    if scene.scale != "METRIC":
        return "none known: lengths are in units of the scene alone"
    return "meters" if scene.scaling is None else f"meters, by {scene.scaling.source.replace('_', ' ')}"


def _verdict(photo: PhotoVerdict) -> str:
    where = "placed" if photo.placed else f"not placed: {(photo.not_placed or 'unknown').replace('_', ' ')}"
    return ", ".join((where, *photo.defects))


def _pairs(path: Path) -> tuple[PointPair, ...]:
    try:
        lines = path.read_text().splitlines()
        rows = [[float(part) for part in line.split(",")] for line in lines if line.partition("#")[0].strip()]
    except (OSError, ValueError) as error:
        raise InvalidInputError(f"{path} cannot be read: {error}", field="pairs") from error
    if wrong := [row for row in rows if len(row) != 6]:
        raise InvalidInputError(
            f"{path} has a line of {len(wrong[0])} numbers", field="pairs", limit="6 numbers a line"
        )
    return tuple(PointPair(Vector3(*row[:3]), Vector3(*row[3:])) for row in rows)
