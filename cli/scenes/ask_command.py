"""`fastsplat ask`: questions in plain words to one scene, with where the asker stands."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated

import typer

from fastsplat.cli.options import SceneId, Version
from fastsplat.cli.scenes.export import write_file
from fastsplat.cli.session import Session
from fastsplat.cli.tables import point
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.geometry.poses import Pose, Quaternion, Vector3, unit_quaternion
from fastsplat_contract.jobs.job_watching import Until
from fastsplat_contract.messages.queries import Answer, QueryRequest

ANY_WORD = "To look for words of any kind: fastsplat models use open-vocabulary"
_DRAFTS = {"points": "points, and what the first photos show", "training": "a training under way"}


def ask(
    session: Session,
    scene: SceneId,
    texts: Annotated[
        list[str],
        typer.Argument(
            metavar="TEXT...",
            help='As "something to drink from", "the red mug left of the lamp", "how many cups are there".',
        ),
    ],
    asker_view: Annotated[
        str, typer.Option("--from", help="Where you stand: the name of one of the scene's cameras.")
    ] = "",
    pose: Annotated[
        str,
        typer.Option(
            help="Your viewpoint instead: a camera's position and quaternion, OpenCV axes.", metavar="X,Y,Z,QX,QY,QZ,QW"
        ),
    ] = "",
    picture: Annotated[Path | None, typer.Option(help="Write a PNG of the answer to one text.")] = None,
    version: Version = "",
    wait: Annotated[
        Until | None,
        typer.Option(
            help="Of a scene that is still being made: wait for its first draft, one of its training (good), or its "
            "end (done). Default: ask what is there."
        ),
    ] = None,
) -> None:
    """Ask a scene in plain words. Prints a sentence, then the objects that answer."""
    if picture is not None and len(texts) != 1:
        raise InvalidInputError(f"one picture of {len(texts)} answers", field="--picture", hint="Ask one text.")
    asker = _pose(pose) if pose else None
    scene_id = session.scene(scene)
    if wait is not None:
        session.client.wait_for_scene(scene_id, wait)
    exact = session.version(scene_id, version)
    request = QueryRequest(
        scene_id,
        tuple(texts),
        outputs=frozenset({"objects"}),
        version=exact,
        asker=asker,
        asker_view=asker_view or None,
    )
    result = session.client.ask_everywhere(request)
    session.tell(result, "\n".join(line for answer in result.answers for line in answer_lines(answer)))
    unsaid = (answer for answer in result.answers if answer.outcome == "cannot_say" and answer.phrase is None)
    if any(answer.searched.unnamed_objects for answer in unsaid):  # one without a name may be it
        models = session.client.server_status().models
        if any(model.role == "open_set_detector" and model.state == "unset" for model in models):
            typer.echo(ANY_WORD, err=True)
    if picture is not None:
        write_file(picture, _picture(session, result.answers[0]))


def answer_lines(answer: Answer) -> list[str]:
    """An answer for people: its sentence, then the objects."""
    lines = [answer.sentence]
    if answer.provisional is not None:
        lines.append(f"  by a draft: {_DRAFTS[answer.provisional.stage]}; the scene is not finished")
    for obj in answer.objects or ():
        unit = "m" if obj.meters else "scene units"
        lines.append(f"  object {obj.id}, {obj.name}, at {point(obj.centroid or ())} {unit}")
    if answer.object_ids and not answer.objects:  # none of them has a name
        lines.append(f"  objects that may be it: {', '.join(map(str, answer.object_ids))}")
        lines.append(f"  to name one: fastsplat objects name SCENE {shlex.quote(answer.noun_phrase)} OBJECT")
    return lines


def _picture(session: Session, answer: Answer) -> bytes:
    """Draws the answer over the view that shows it best, else over the middle view."""
    views: list[str] = []
    if answer.shows_something:
        best = session.client.best_views(answer.scene_id, text=answer.text, max_views=1, version=answer.version)
        views = [best_view.view for best_view in best]
    if not views:
        cameras = session.client.scene(answer.scene_id).cameras
        views = [cameras[len(cameras) // 2].name]
    return session.client.picture(answer.scene_id, "overlay", views[0], text=answer.text, version=answer.version)


def _pose(text: str) -> Pose:
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) != 7:
        raise InvalidInputError(f"a pose {text[:80]!r}", field="pose", hint="Write X,Y,Z,QX,QY,QZ,QW.")
    return Pose(Vector3(*values[:3]), unit_quaternion(Quaternion(*values[3:])))
