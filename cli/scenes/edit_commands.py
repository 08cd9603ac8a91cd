"""`fastsplat objects` and `scenes clean`: edits, which make versions, and steps between versions."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fastsplat.cli.options import SceneId, Watch, service_command
from fastsplat.cli.scenes.object_commands import objects_app
from fastsplat.cli.scenes.scene_commands import scenes_app
from fastsplat.cli.session import Session
from fastsplat.cli.short_ids import SHORT
from fastsplat.cli.tables import Column, minute, table
from fastsplat_contract.codec.json_codec import from_json
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.geometry.gaussian_filters import GaussianFilter
from fastsplat_contract.geometry.object_prompts import ObjectPrompt
from fastsplat_contract.geometry.poses import Box, Pose, Quaternion, Vector3
from fastsplat_contract.jobs.name_suggestions import SuggestIn
from fastsplat_contract.jobs.operations import Operation
from fastsplat_contract.messages.objects import ObjectList, Pixel, PixelBox
from fastsplat_contract.messages.scenes import Edit, InsertSource, SceneVersion, VersionList

_Ids = Annotated[list[int], typer.Argument(help="Ids of objects, from the list.", metavar="OBJECT...")]
_LookedAt = Annotated[
    str, typer.Option(help="The version that you looked at; only names that stood in it are replaced.")
]
_View = Annotated[str, typer.Option(help="Name of one of the scene's cameras.")]
_OnObject = Annotated[
    list[str], typer.Option(help="Of the view, on the object; several are allowed.", metavar="X,Y", show_default=False)
]
_BesideObject = Annotated[
    list[str],
    typer.Option(help="Of the view, beside the object; several are allowed.", metavar="X,Y", show_default=False),
]
_AroundObject = Annotated[
    tuple[float, float, float, float] | None,
    typer.Option(help="Of the view, around the object: left top right bottom."),
]
_NewName = Annotated[str | None, typer.Option(help="Its new name.")]
_Aliases = Annotated[list[str], typer.Option(help="Another name of it; several are allowed.")]
_Kinds = Annotated[
    list[str], typer.Option(help="Kind of an object whose name does not say it, as Oskar; several are allowed.")
]


@service_command(objects_app)
def name(
    session: Session,
    scene: SceneId,
    name: Annotated[str, typer.Argument(metavar="NAME", help="Their new name.")],
    objects: _Ids,
    alias: _Aliases = [],
    kind: _Kinds = [],
    looked_at: _LookedAt = "",
) -> None:
    """Give objects a name."""
    edit = Edit("name", object_ids=tuple(objects), name=name, aliases=tuple(alias), kinds=tuple(kind))
    _edit(session, scene, edit, looked_at)


@service_command(objects_app)
def suggest(
    session: Session,
    scene: SceneId,
    file: Annotated[
        Path,
        typer.Argument(
            help='JSON: {"suggestions": [{object_id, name, probability, source, and any model and aliases}]}.',
            exists=True,
            dir_okay=False,
        ),
    ],
) -> None:
    """Suggest names for objects, which become names once somebody confirms them."""
    try:
        suggested = from_json(SuggestIn, file.read_bytes()).suggestions
    except InvalidInputError as error:
        raise error.within("file") from error
    new_version = session.client.suggest_names(session.scene(scene), suggested)
    session.tell(new_version, f"{len(suggested)} names suggested\nversion {new_version.version} is current")


@service_command(objects_app)
def ask_captioner(
    session: Session,
    scene: SceneId,
    url: Annotated[
        str,
        typer.Argument(
            help="Of a model's OpenAI-compatible interface, e.g. http://localhost:11434/v1, to which pictures go from "
            "here; left out: the server's own captioner is asked, by a job."
        ),
    ] = "",
    model: Annotated[str, typer.Argument(help="As the interface calls it; it must see pictures.")] = "",
    captioner_key: Annotated[Path | None, typer.Option(help="File with the interface's key.", exists=True)] = None,
    agree: Annotated[
        str, typer.Option(help="Agree, once for the project, that pictures go to this host of the server's captioner.")
    ] = "",
    watch: Watch = False,
) -> None:
    """Send pictures of objects without a name to a model, and suggest its names."""
    from fastsplat_client.captioner import Captioner, suggest_by

    if not url:
        if agree:
            session.client.agree_to_captioner(agree)
        session.tell_job(session.client.ask_captioner(session.scene(scene)), _said, watch=watch)
        return
    captioner = Captioner(url, model, captioner_key.read_text().strip() if captioner_key is not None else "")
    said = suggest_by(session.client, session.scene(scene), captioner)
    by = f"{captioner.model} at {captioner.host}"
    session.tell(SuggestIn(said.names), _summary(len(said.names), said.objects, said.refused, by, said.problem))


def _said(operation: Operation) -> str:
    result = operation.ask_captioner
    assert result is not None
    return _summary(result.suggested, result.objects, result.refused, "the server's captioner", result.problem)


def _summary(names: int, objects: int, refused: int, who: str, problem: str) -> str:
    lines = [f"{names} names suggested for {objects} objects by {who}"]
    if refused:
        lines.append(f"{refused} refused: unusable, or the same for too many objects")
    if problem:
        lines.append(f"not all objects were asked about: {problem}")
    return "\n".join(lines)


@service_command(objects_app)
def confirm(
    session: Session,
    scene: SceneId,
    least: Annotated[float, typer.Option(help="Probability, 0 to 1, from which a suggested name is given.")] = 0.8,
) -> None:
    """Give objects without a name the likeliest one that is suggested for them."""
    scene_id = session.scene(scene)
    named = session.client.confirm_names(scene_id, least=least)
    lines = [f"object {obj.id} is {obj.suggestions[0].name!r}" for obj in named]
    session.tell(ObjectList(named, "", ""), "\n".join(lines) or "no suggestion is so probable")


@service_command(objects_app)
def unname(session: Session, scene: SceneId, objects: _Ids, looked_at: _LookedAt = "") -> None:
    """Take the names of objects away."""
    _edit(session, scene, Edit("unname", object_ids=tuple(objects)), looked_at)


@service_command(objects_app)
def merge(session: Session, scene: SceneId, objects: _Ids, looked_at: _LookedAt = "") -> None:
    """Make several objects one, under the id and the name of the first."""
    _edit(session, scene, Edit("merge", object_ids=tuple(objects)), looked_at)


@service_command(objects_app)
def discard(session: Session, scene: SceneId, objects: _Ids, looked_at: _LookedAt = "") -> None:
    """Say that these are no objects; their Gaussians stay."""
    _edit(session, scene, Edit("discard", object_ids=tuple(objects)), looked_at)


@service_command(objects_app)
def insert(
    session: Session,
    scene: SceneId,
    source: Annotated[str, typer.Argument(help="The scene that they come from, of the same project, by its id.")],
    objects: Annotated[list[int], typer.Argument(help="Ids of the other scene's objects.", metavar="OBJECT...")],
    position: Annotated[
        tuple[float, float, float], typer.Option(help="x y z here, in scene units, of the other scene's origin.")
    ] = (0.0, 0.0, 0.0),
    orientation: Annotated[
        tuple[float, float, float, float],
        typer.Option(help="Rotation from the other scene's frame into this one's: unit quaternion x y z w."),
    ] = (0.0, 0.0, 0.0, 1.0),
    source_version: Annotated[str, typer.Option(help="Of the other scene. Default: its current one.")] = "",
) -> None:
    """Put objects of another scene into this one, with new ids and their names."""
    edit = Edit(
        "insert",
        object_ids=tuple(objects),
        transform=Pose(Vector3(*position), Quaternion(*orientation)),
        source=InsertSource(*session.at(source, source_version)),
    )
    _edit(session, scene, edit, "")


@service_command(objects_app)
def split(
    session: Session,
    scene: SceneId,
    obj: Annotated[int, typer.Argument(metavar="OBJECT", help="Id of the object, from the list.")],
    view: _View = "",
    pixel: _OnObject = [],
    beside: _BesideObject = [],
    box: _AroundObject = None,
    name: _NewName = None,
    alias: _Aliases = [],
    looked_at: _LookedAt = "",
) -> None:
    """Split the piece at a pixel or in a view's box off its object."""
    edit = Edit("split", object_ids=(obj,), prompt=_prompt(view, pixel, beside, box), name=name, aliases=tuple(alias))
    _edit(session, scene, edit, looked_at)


@service_command(objects_app)
def add(
    session: Session,
    scene: SceneId,
    view: _View = "",
    pixel: _OnObject = [],
    beside: _BesideObject = [],
    box: _AroundObject = None,
    name: _NewName = None,
    alias: _Aliases = [],
    looked_at: _LookedAt = "",
) -> None:
    """Add an object at a pixel or in a box of a view."""
    edit = Edit("add", prompt=_prompt(view, pixel, beside, box), name=name, aliases=tuple(alias))
    _edit(session, scene, edit, looked_at)


def _edit(session: Session, scene: str, edit: Edit, looked_at: str) -> None:
    scene_id, looked_at = session.at(scene, looked_at)
    new_version = session.client.edit_scene(scene_id, [edit], looked_at=looked_at)
    lines = []
    for new in new_version.prompted:
        agree = f", seen in {len(new.views)} views" if len(new.views) > 1 else ", seen in one view"
        lines.append(f"object {new.object_id} has {new.gaussian_count} Gaussians{agree}")
    if new_version.asks_kind:
        lines.append(f"no word of {edit.name!r} is known here: to be found by what it is, name it again with --kind")
    session.tell(new_version, "\n".join([*lines, f"version {new_version.version} is current"]))


def _prompt(
    view: str, pixels: list[str], beside: list[str], box: tuple[float, float, float, float] | None
) -> ObjectPrompt:
    return ObjectPrompt(
        view=view or None,
        pixels=tuple(_pixel(text, "pixel") for text in pixels),
        background=tuple(_pixel(text, "beside") for text in beside),
        box=None if box is None else PixelBox(*box),
    )


def _pixel(text: str, option: str) -> Pixel:
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError as error:
        raise InvalidInputError(
            f"a pixel at {text[:40]!r}", field=option, hint=f"Write --{option} X,Y, as in --{option} 120.5,80."
        ) from error
    return Pixel(x, y)


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
    _tell(session, session.client.undo_edit(*session.at(scene, only)))


@service_command(objects_app)
def redo(session: Session, scene: SceneId, only: _Only = "") -> None:
    """Go forward to the version that was undone."""
    _tell(session, session.client.redo_edit(*session.at(scene, only)))


@service_command(objects_app)
def restore(
    session: Session, scene: SceneId, version: Annotated[str, typer.Argument(help="A version of the list of versions.")]
) -> None:
    """Make any version current; all others stay."""
    _tell(session, session.client.restore_version(*session.at(scene, version)))


def _tell(session: Session, version: SceneVersion) -> None:
    session.tell(version, f"version {version.version} is current")
