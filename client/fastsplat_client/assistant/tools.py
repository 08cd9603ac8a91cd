"""Tools of an assistant as functions over a `Client`; `server` offers them.

Their docstrings and the descriptions of their parameters are for a model that has never seen the service. A scene is
given by id or name, or left out if alone.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from itertools import islice
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from fastsplat_client.assistant import tool_results
from fastsplat_client.assistant.tool_results import brief_of, plain, point
from fastsplat_client.client import Client
from fastsplat_contract.errors import InvalidInputError, NotFoundError
from fastsplat_contract.geometry.gaussian_filters import GaussianFilter
from fastsplat_contract.geometry.poses import Box, Pose, Quaternion, Vector3
from fastsplat_contract.messages.measurements import Length
from fastsplat_contract.messages.objects import AskedLevel, SceneObject
from fastsplat_contract.messages.queries import Answer
from fastsplat_contract.messages.scenes import Edit, Scene, SceneSummary

_MOST_PLACES = 5
_MOST_SCENES = 200
_MOST_OFFERED = 20
_MOST_NAMES = 100
_MOST_OBJECTS = 100
_MOST_IDS = 500
_MOST_WITNESSES = 20
_BELOW_1 = math.nextafter(1.0, 0.0)
_MOST_ID = 65_535
SCENE_ID = re.compile("[0-9a-f]{32}")

_ALONG = float(np.cos(np.radians(0.1)))
"""Cosine of the angle within which an axis is said to be the vertical."""


SceneName = Annotated[
    str, Field(max_length=200, description="id or name of the scene; may be left out where only one is ready")
]
_Coordinate = Annotated[float, Field(allow_inf_nan=False)]
Point = tuple[_Coordinate, _Coordinate, _Coordinate]
_Object = Annotated[int, Field(ge=0, le=_MOST_ID, description="id of an object, as other tools return it")]


def resolve_scene(client: Client, scene: str) -> Scene:
    """The scene of that id or name, or, for "", the project's only one that is ready. Scenes are listed only for names,
    and no further than it takes to say that too many fit.

    Raises:
        InvalidInputError: none, or several, fit.
    """
    if SCENE_ID.fullmatch(scene):
        with suppress(NotFoundError):
            return client.scene(scene)
    listed: list[SceneSummary] = []
    fitting: list[SceneSummary] = []
    for summary in client.scenes():
        listed = [*listed, summary][:_MOST_OFFERED]
        if summary.name.casefold() == scene.casefold() if scene else bool(summary.version):
            fitting.append(summary)
        if len(fitting) > _MOST_OFFERED:
            break
    if len(fitting) == 1:
        return client.scene(fitting[0].id)
    names = "; ".join(f"{summary.id} ({plain(summary.name)})" for summary in (fitting or listed)[:_MOST_OFFERED])
    count = f"more than {_MOST_OFFERED}" if len(fitting) > _MOST_OFFERED else str(len(fitting))
    what = f"{count} scenes fit {scene[:80]!r}" if scene else f"{count} scenes are ready, and none was named"
    raise InvalidInputError(
        what, field="scene", hint=f"Name one by its id: {names}." if names else "Make a scene first."
    )


def list_scenes(client: Client) -> tool_results.Scenes:
    """Scenes of the project, newest first, with state (only READY ones can be asked), unit of length and date."""
    every = list(client.scenes())
    scenes = [
        tool_results.SceneInList(
            scene.id,
            scene.name,
            scene.state,
            scene.object_count,
            _unit_of(scene),
            (scene.captured_at or scene.created_at).isoformat(timespec="minutes"),
        )
        for scene in every[:_MOST_SCENES]
    ]
    return tool_results.Scenes(scenes, len(every) - len(scenes))


def describe_scene(client: Client, scene: SceneName = "") -> tool_results.SceneDescription:
    """What a scene holds: names with counts, unnamed objects, extent, unit of length, what is up, and its grade."""
    target = resolve_scene(client, scene)
    objects = list(client.objects(target.id, version=target.version))
    names = Counter(obj.name for obj in objects if obj.name)
    low, high = _bounds_of([obj.box for obj in objects if obj.box is not None])
    assessment = target.assessment
    return tool_results.SceneDescription(
        id=target.id,
        name=target.name,
        version=target.version,
        grade=None if assessment is None else assessment.grade,
        advice=[] if assessment is None else [f"{finding.message} {finding.advice}" for finding in assessment.findings],
        unit=_unit_of(target),
        unit_source=_unit_source(target),
        up=up_of(target),
        photos=target.camera_count,
        names=dict(names.most_common(_MOST_NAMES)),
        more_names=max(0, len(names) - _MOST_NAMES),
        unnamed_objects=sum(not obj.name for obj in objects),
        center=None if low is None or high is None else _rounded((low + high) / 2),
        size=None if low is None or high is None else _rounded(high - low),
    )


def list_objects(
    client: Client,
    scene: SceneName = "",
    name: Annotated[str, Field(description="only objects that bear this name; empty: all")] = "",
    limit: Annotated[int, Field(ge=1, le=500, description="at most so many")] = 100,
) -> tool_results.Objects:
    """Objects of a scene with id, name, probability of the name, center and size."""
    target = resolve_scene(client, scene)
    bearing = [obj for obj in client.objects(target.id) if not name or obj.name.casefold() == name.casefold()]
    return tool_results.Objects(
        target.id,
        target.version,
        _unit_of(target),
        [brief_of(obj) for obj in bearing[:limit]],
        max(0, len(bearing) - limit),
    )


def pick_object(
    client: Client,
    view: Annotated[str, Field(description="name of one of the scene's photos")],
    x: Annotated[float, Field(ge=0, le=1, description="from the left edge 0 to the right edge 1")],
    y: Annotated[float, Field(ge=0, le=1, description="from the upper edge 0 to the lower edge 1")],
    level: Annotated[
        AskedLevel, Field(description="a part, the whole object, a group of objects, or what is likeliest meant")
    ] = "likeliest",
    scene: SceneName = "",
) -> tool_results.PickedBrief:
    """Which object a photo shows at a place, which part of it is there, and in which group of objects it is."""
    target = resolve_scene(client, scene)
    posed = next((camera for camera in target.cameras if camera.name == view), None)
    if posed is None:
        raise NotFoundError(f"no view {view[:80]!r} in this scene", field="view", hint="Use names of its photos.")
    pixel = min(x, _BELOW_1) * posed.camera.width, min(y, _BELOW_1) * posed.camera.height
    picked = client.pick(target.id, view, pixel=pixel, level=level)
    return tool_results.PickedBrief(
        target.id,
        picked.version,
        _unit_of(target),
        brief_of(picked.object),
        None if picked.part is None else brief_of(picked.part),
        [hit._replace(probability=round(hit.probability, 3)) for hit in picked.levels],
        picked.level,
        0 if picked.mask is None else picked.mask.area,
    )


def find(
    client: Client,
    text: Annotated[str, Field(description="what is looked for, in plain words: a name, a kind, a use")],
    scene: SceneName = "",
) -> tool_results.Found:
    """Is there such an object, what is it called here, where is it, how many are there ("cups on the table")? Also
    by kind and use ("something to drink from"), and over time, where photos of other days are kept ("what moved
    since Monday?", "when was the mug last seen?")."""
    target = resolve_scene(client, scene)
    answer = _ask(client, target.id, text)
    labels = [match.label for match in answer.matches if match.relevant]
    label_id = next((match.label_id for match in answer.matches if match.relevant), None)
    leading = [obj for obj in answer.objects or () if obj.label_id == label_id]
    counted = [obj.id for obj in leading]
    # What may be here, or merely serves in its place, is no number of it.
    refused = answer.outcome not in ("here", "not_here") and answer.relation_subject != "label"
    if answer.phrase is not None:
        counted, refused = list(answer.phrase.object_ids), answer.phrase.refusal is not None
    return tool_results.Found(
        scene=target.id,
        question=text,
        outcome=answer.outcome,
        relation=answer.relation,
        probability=answer.probability,
        label=labels[0] if labels else "",
        sentence=answer.sentence,
        alternatives=labels[1:],
        objects=_briefs(client, answer, answer.object_ids),
        more_objects=max(0, len(answer.object_ids) - _MOST_OBJECTS),
        count=None if refused else len(counted),
        counted=[] if refused else counted[:_MOST_IDS],
        places=[_located(client, answer.scene_id, obj, answer.version) for obj in leading[:_MOST_PLACES]],
        more_places=max(0, len(leading) - _MOST_PLACES),
        unit=_unit_of(target),
        frame=_frame_of(target),
        unnamed_objects=answer.searched.unnamed_objects,
        draft=None if answer.provisional is None else answer.provisional.stage,
    )


def relations(
    client: Client,
    text: Annotated[
        str,
        Field(
            description='a question about how or where objects are: "the mug left of the lamp", "what is on the '
            'table?", "the largest book", "the second cup from the left"'
        ),
    ],
    view: Annotated[
        str, Field(description="name of the photo from whose place left, right, in front and behind are meant")
    ] = "",
    scene: SceneName = "",
) -> tool_results.Related:
    """Which objects stand in a relation, have a color or a size, by measurement; or why that cannot be decided."""
    target = resolve_scene(client, scene)
    answer = _ask(client, target.id, text, asker_view=view or None)
    phrase = answer.phrase
    if phrase is None:
        raise InvalidInputError(
            f"{text[:80]!r} says nothing of where or how an object is",
            field="text",
            hint='Say more, as "the mug left of the lamp", "the largest book", or use find.',
        )
    return tool_results.Related(
        scene=target.id,
        question=text,
        understood=list(phrase.conditions),
        objects=_briefs(client, answer, phrase.object_ids),
        more_objects=max(0, len(phrase.object_ids) - _MOST_OBJECTS),
        undecided=list(phrase.undecided[:_MOST_IDS]),
        refusal="" if phrase.refusal is None else phrase.refusal.reason,
        sentence=answer.sentence,
        evidence=[
            witness._replace(
                compared_ids=witness.compared_ids[:_MOST_WITNESSES],
                value=round(witness.value, 4),
                clearness=round(witness.clearness, 2),
            )
            for witness in phrase.witnesses[:_MOST_WITNESSES]
        ],
        unit=_unit_of(target),
    )


def measure(
    client: Client,
    first: _Object,
    second: Annotated[int, Field(ge=0, le=_MOST_ID, description="id of another object; 0: the size of the first")] = 0,
    scene: SceneName = "",
) -> tool_results.Measured:
    """How far two objects are from each other, or how large one is, with 95 % intervals."""
    target = resolve_scene(client, scene)
    measured = client.measure(target.id, *((first, second) if second else (first,)))
    unit: tool_results.Unit = "m" if measured.meters else "scene units"
    distance, between = (
        None if length is None else _interval(length) for length in (measured.distance, measured.center_distance)
    )
    sides = [_interval(side) for side in measured.sides]
    if distance is not None:
        sentence = f"From object {first} to object {second} it is {_spoken(distance, unit)}."
    else:
        sentence = f"The box of object {first} is " + " by ".join(_spoken(side, unit) for side in sides) + "."
    return tool_results.Measured(target.id, unit, distance, between, sides, sentence)


def goal(
    client: Client,
    object_id: Annotated[
        int, Field(ge=1, le=_MOST_ID, description="id of the object to see, as other tools return it")
    ],
    robot_radius: Annotated[float, Field(gt=0, le=5, description="of the robot, meters")] = 0.2,
    scene: SceneName = "",
) -> tool_results.StandingPlace:
    """Where a robot stands to see an object: the nearest free place on the floor, and which way to look. Refused
    for scenes without meters, a known vertical or a floor, and where no such place was seen."""
    target = resolve_scene(client, scene)
    place = client.goal(target.id, object_id, robot_radius, version=target.version)
    x, y, _ = position = point(place.pose.position)
    sentence = (
        f"From ({x:g}, {y:g}) m, turned {math.degrees(place.yaw):.0f} degrees from the x axis, object {object_id} is "
        f"in sight, {place.distance:.2f} m away; whether the robot can get there is not known."
    )
    if place.floor_source == "lowest_level":
        sentence += " Nothing is known as the floor: it was taken to be the lowest level seen."
    return tool_results.StandingPlace(
        target.id,
        object_id,
        _frame_of(target),
        position,
        round(place.yaw, 4),
        round(place.distance, 4),
        round(place.clearance, 4),
        sentence,
    )


def name_object(
    client: Client,
    object_id: _Object,
    name: Annotated[str, Field(description="what the user calls it")],
    aliases: Annotated[list[str] | None, Field(description="other names of the same")] = None,
    kinds: Annotated[
        list[str] | None, Field(description="what it is, of a name that does not say so: teddy bear, for Oskar")
    ] = None,
    replaces: Annotated[
        str, Field(description="the name that it has now, where a person gave one and the user means to replace it")
    ] = "",
    scene: SceneName = "",
) -> tool_results.Named:
    """Give an object its name, when the user says what it is; it is then found by that name and by its meaning."""
    target = resolve_scene(client, scene)
    looked_at = (
        target.version if replaces and _name_of(client, target, object_id) == replaces.strip().casefold() else ""
    )
    version = client.name_objects(
        target.id, object_id, name, aliases=aliases or (), kinds=kinds or (), looked_at=looked_at
    )
    return tool_results.Named(target.id, object_id, name, version.version, version.asks_kind)


def photograph_next(client: Client, scene: SceneName = "") -> tool_results.NextPhotos:
    """Where the user should stand for the photos that would improve the scene most."""
    target = resolve_scene(client, scene)
    places = [
        tool_results.NextPhotoPlace(photo.advice, photo.near, _rounded(photo.camera.world_from_camera[:3, 3]))
        for photo in client.next_photos(target.id)
    ]
    return tool_results.NextPhotos(target.id, _unit_of(target), places)


def scene_status(client: Client, scene: SceneName = "") -> tool_results.JobStatus:
    """How far a scene's training is, how long it still takes, and why it failed if it did."""
    target = resolve_scene(client, scene)
    jobs = (operation for operation in client.operations() if operation.scene_id == target.id)
    job = next(jobs, None) or client.operation(target.operation_id)
    stage = job.stages[-1] if job.stages else None
    return tool_results.JobStatus(
        scene=target.id,
        state=target.state,
        job=job.state,
        stage=stage.stage if stage else "",
        fraction=stage.fraction if stage else 0.0,
        message=stage.message if stage else "",
        seconds_left=job.seconds_left,
        error="" if job.error is None else f"{job.error.message} {job.error.details.get('hint', '')}".strip(),
    )


def _ask(client: Client, scene_id: str, text: str, **choices: Any) -> Answer:
    (answer,) = client.query(scene_id, text, outputs=["objects"], **choices)
    return answer


def _briefs(client: Client, answer: Answer, ids: Sequence[int]) -> list[tool_results.ObjectBrief]:
    """The first of these objects, in their order."""
    wanted = dict.fromkeys(ids[:_MOST_OBJECTS])
    found: dict[int, SceneObject] = {}
    for obj in client.objects(answer.scene_id, version=answer.version, parts=True) if wanted else ():
        if obj.id in wanted:
            found[obj.id] = obj
        if len(found) == len(wanted):
            break  # what follows is pages of objects that nobody asked for
    return [brief_of(found[number]) for number in wanted if number in found]


def _name_of(client: Client, scene: SceneSummary, object_id: int) -> str:
    """What an object is called, without regard to case; "" for an object without a name, or none."""
    objects = client.objects(scene.id, version=scene.version, parts=True)
    return next((obj.name.casefold() for obj in objects if obj.id == object_id), "")


def _located(client: Client, scene_id: str, obj: SceneObject, version: str) -> tool_results.WhereAbouts:
    measured = client.measure(scene_id, obj.id, version=version)
    place = measured.places[0]
    return tool_results.WhereAbouts(
        obj.id,
        obj.name,
        point(place.point),
        round(place.plus_minus, 4),
        [_interval(side) for side in measured.sides],
        list(islice(obj.best_views, 3)),
    )


def _bounds_of(boxes: list[Box]) -> tuple[np.ndarray | None, np.ndarray | None]:
    """The axis-aligned box around oriented ones."""
    if not boxes:
        return None, None
    signs = np.array(np.meshgrid([-0.5, 0.5], [-0.5, 0.5], [-0.5, 0.5])).reshape(3, -1).T
    corners = np.concatenate(
        [(signs * box.size) @ box.center.matrix()[:3, :3].T + box.center.matrix()[:3, 3] for box in boxes]
    )
    return corners.min(axis=0), corners.max(axis=0)


def _rounded(values: np.ndarray) -> tool_results.Point:
    """A place or an extent, [3], to four decimals."""
    x, y, z = (round(float(value), 4) for value in values)
    return (x, y, z)


def _unit_of(scene: SceneSummary) -> tool_results.Unit:
    return "m" if scene.scale == "METRIC" else "scene units"


def _unit_source(scene: Scene) -> str:
    """What says how long a scene unit is, as a sentence."""
    if scene.scale == "ARBITRARY":
        return "nothing says how long a scene unit is; say no length in meters"
    if scene.scaling is None:
        return "poses in meters came with the capture"
    scaling = scene.scaling
    share = 100 * (scaling.high - scaling.low) / 2 / scaling.meters_per_unit
    return f"{scaling.source}; lengths are right within {share:.1f} % in 95 % of cases"


def up_of(scene: Scene) -> str:
    """Which way is up, and how sure that is, as a sentence."""
    if scene.vertical is None:
        return "not known"
    up = scene.vertical.up
    axis = "+z" if up.z > _ALONG else f"({up.x:.3f}, {up.y:.3f}, {up.z:.3f})"
    return f"{axis}, by {scene.vertical.source}, within {2 * scene.vertical.deviation_deg:.1f} degrees"


def _frame_of(scene: Scene) -> str:
    """The frame of all places of a scene, as words."""
    named = "" if scene.alignment is None else scene.alignment.frame
    return f"map frame {named!r}" if named else "the scene's own world frame"


def _interval(length: Length) -> Length:
    """A measured length with its 95 % interval."""
    return Length._make(round(value, 4) for value in length)


def _spoken(length: Length, unit: tool_results.Unit) -> str:
    return f"{length.value:g} {unit} (95 %: {length.low:g} to {length.high:g})"


def clean_up(
    client: Client,
    corners: Annotated[
        tuple[Point, Point] | None,
        Field(description="of a box, as x, y, z: the lowest, then the highest; only what lies in it"),
    ] = None,
    outside: Annotated[bool, Field(description="only what lies outside of the box instead: to crop to it")] = False,
    opacity_below: Annotated[float | None, Field(description="only what is less opaque than this, 0 to 1")] = None,
    isolation_above: Annotated[
        float | None,
        Field(description="only what hangs in the air: so many times farther from others than usual; try 4"),
    ] = None,
    objects: Annotated[list[int] | None, Field(description="only of these objects, by their ids")] = None,
    remove: Annotated[
        bool, Field(description="whether to remove it, when the user says so; otherwise it is only counted")
    ] = False,
    scene: SceneName = "",
) -> tool_results.CleanedUp:
    """How many Gaussians of a scene fulfil all that is said; removes them, as a version that can be undone, if told
    to. At least one of corners, opacity_below and isolation_above."""
    scene_info = resolve_scene(client, scene)
    box = None
    if corners is not None:
        low, high = corners
        middle = Vector3(*((a + b) / 2 for a, b in zip(low, high, strict=True)))
        size = Vector3(*(b - a for a, b in zip(low, high, strict=True)))
        box = Box(Pose(middle, Quaternion(0.0, 0.0, 0.0, 1.0)), size)
    chosen = GaussianFilter(box, outside, opacity_below, isolation_above)
    edits = [Edit("remove", object_ids=tuple(objects or ()), filter=chosen)]
    preview = client.preview_edit(scene_info.id, edits, version=scene_info.version)
    version = client.edit_scene(scene_info.id, edits, looked_at=preview.version).version if remove else ""
    return tool_results.CleanedUp(scene_info.id, preview.gaussians, preview.count, version)
