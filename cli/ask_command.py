"""`fastsplat things ask`: a question in plain words to one scene, with where the asker stands."""

from __future__ import annotations

import json
from typing import Annotated

import typer

from fastsplat.cli.local_service import local_service
from fastsplat.cli.thing_commands import Json, Project, Scene, Version, things_app
from fastsplat.service.store.records import DEFAULT_PROJECT
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.json_codec import to_plain
from fastsplat_contract.poses import Pose, Quaternion, Vector3, unit_quaternion
from fastsplat_contract.queries import QueryRequest


@things_app.command()
def ask(
    scene: Scene,
    text: Annotated[str, typer.Argument(help='As "the red mug left of the lamp" or "how many cups are on the table".')],
    asker_view: Annotated[
        str, typer.Option("--from", help="Where you stand: the name of one of the scene's cameras.")
    ] = "",
    pose: Annotated[
        str,
        typer.Option(
            help="Where you stand instead, as a camera's pose in OpenCV axes: its place and its quaternion.",
            metavar="X,Y,Z,QX,QY,QZ,QW",
        ),
    ] = "",
    version: Version = "",
    project: Project = DEFAULT_PROJECT,
    as_json: Json = False,
) -> None:
    """Ask a scene in plain words, and print the answer in one sentence, or all of it as JSON."""
    request = QueryRequest(
        scene, (text,), version=version, asker=_pose(pose) if pose else None, asker_view=asker_view or None
    )
    with local_service(project) as service:
        (answer,) = service.answers.query(request)
    typer.echo(json.dumps(to_plain(answer), indent=2, ensure_ascii=False) if as_json else answer.sentence)


def _pose(text: str) -> Pose:
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) != 7:
        raise InvalidInputError(f"a pose {text[:80]!r}", field="pose", hint="Write X,Y,Z,QX,QY,QZ,QW.")
    return Pose(Vector3(*values[:3]), unit_quaternion(Quaternion(*values[3:])))
