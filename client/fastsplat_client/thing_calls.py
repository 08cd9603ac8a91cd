"""The calls about things and versions: listed, picked, named, edited, undone."""

from __future__ import annotations

import uuid
from collections.abc import Iterator, Sequence
from typing import Any, TypeVar
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray

from fastsplat_client.errors import read
from fastsplat_client.transport import Transport
from fastsplat_contract.camera import PosedCamera
from fastsplat_contract.detection_messages import Detection, DetectionList
from fastsplat_contract.goal_messages import Goal
from fastsplat_contract.json_codec import to_plain
from fastsplat_contract.look_again_messages import LookAgainIn
from fastsplat_contract.measure_messages import MeasureIn, Measurement
from fastsplat_contract.operations import Operation
from fastsplat_contract.places import Alignment, KnownLength, KnownSize, Place
from fastsplat_contract.poses import Vector3
from fastsplat_contract.scenes import AlignIn, Edit, EditIn, RedoIn, RestoreIn, SceneVersion, UndoIn, VersionList
from fastsplat_contract.thing_messages import PickedThing, PickIn, Pixel, PixelBox, SceneThing, ThingList
from fastsplat_contract.thing_prompts import ThingPrompt
from fastsplat_contract.train_more_messages import PresetName, TrainMoreIn

T = TypeVar("T")
_PAGE = 500
"""Entries that are asked for at a time; a server gives as many as it allows."""


class ThingCalls:
    """The part of `Client` that speaks of things and versions."""

    def __init__(self, transport: Transport) -> None:
        self._transport = transport

    def things(self, scene_id: str, *, version: str = "", parts: bool = False) -> Iterator[SceneThing]:
        """Every thing of a scene, with or without a name, by id; with `parts` each followed by its parts."""
        query = {"version": version} | ({"parts": "true"} if parts else {})
        return self._pages(ThingList, f"{scene_path(scene_id)}/things", query)

    def thing_ids(self, scene_id: str, *, version: str = "") -> NDArray[np.uint16]:
        """uint16 [G]: which thing each Gaussian belongs to, by row; 0 for none."""
        path = f"{scene_path(scene_id)}/things.bin"
        content = self._transport.call("GET", path, params={"version": version}).content
        return np.frombuffer(content, dtype="<u2").astype(np.uint16)

    def pick(
        self,
        scene_id: str,
        viewpoint: str | PosedCamera | None = None,
        *,
        pixel: tuple[float, float] | None = None,
        box: tuple[float, float, float, float] | None = None,
        point: tuple[float, float, float] | None = None,
        version: str = "",
    ) -> PickedThing:
        """The thing at a place, with its mask, and the part of it there.

        Args:
            scene_id: which scene.
            viewpoint: one of the scene's own cameras (its name) or a free viewpoint; None for a point.
            pixel: x, y in the viewpoint's picture; the middle of its first pixel is (0.5, 0.5).
            box: left, top, right, bottom, instead of `pixel`.
            point: x, y, z in the world frame, instead of `pixel`.
            version: of the scene; "" is the current one.
        """
        request = PickIn(
            camera=None if isinstance(viewpoint, str) else viewpoint,
            view=viewpoint if isinstance(viewpoint, str) else None,
            pixel=None if pixel is None else Pixel(*pixel),
            box=None if box is None else PixelBox(*box),
            point=None if point is None else Vector3(*point),
            version=version,
        )
        path = f"{scene_path(scene_id)}:pick"
        return read(PickedThing, self._transport.call("POST", path, json=to_plain(request)))

    def measure(self, scene_id: str, *places: Place | int, version: str = "") -> Measurement:
        """Where one place is, how large one thing is, or how far two places are from each other.

        Args:
            scene_id: which scene.
            places: one or two; a number is the id of a thing.
            version: of the scene; "" is the current one.
        """
        request = MeasureIn(tuple(Place(thing=one) if isinstance(one, int) else one for one in places), version)
        path = f"{scene_path(scene_id)}:measure"
        return read(Measurement, self._transport.call("POST", path, json=to_plain(request)))

    def goal(self, scene_id: str, thing_id: int, robot_radius: float = 0.0, *, version: str = "") -> Goal:
        """The free place nearest to a thing from which a robot sees it; of scenes in meters with z up.

        Args:
            scene_id: which scene.
            thing_id: of a thing or a part.
            robot_radius: meters; 0: 0.2.
            version: of the scene; "" is the current one.
        """
        params = {"thing_id": thing_id, "robot_radius": robot_radius, "version": version}
        return read(Goal, self._transport.call("GET", f"{scene_path(scene_id)}/goal", params=params))

    def detections(self, scene_id: str, *, version: str = "") -> Iterator[Detection]:
        """Every thing of a scene as a robot needs it, by id: pose and covariance, names, what carries it, who saw it.
        Frame and unit say the pages of `detection_page`."""
        return self._pages(DetectionList, f"{scene_path(scene_id)}/detections", {"version": version})

    def detection_page(self, scene_id: str, *, version: str = "", page_token: str = "") -> DetectionList:
        """One page of `detections`, with their frame, their unit and what is up."""
        params = {"version": version, "page_token": page_token}
        return self._get(DetectionList, f"{scene_path(scene_id)}/detections", params)

    def scale_scene(self, scene_id: str, *known: KnownLength | KnownSize) -> SceneVersion:
        """Make a new version whose units are meters by these lengths, these sizes of things, and those of before, see
        `Scene.scaling`."""
        lengths = tuple(each for each in known if isinstance(each, KnownLength))
        sizes = tuple(each for each in known if isinstance(each, KnownSize))
        return self.edit_scene(scene_id, [Edit("scale", known_lengths=lengths, known_sizes=sizes)])

    def name_things(
        self, scene_id: str, things: int | Sequence[int], name: str, *, aliases: Sequence[str] = (), looked_at: str = ""
    ) -> SceneVersion:
        """Make a new version in which these things have a name; see `edit_scene`."""
        ids = (things,) if isinstance(things, int) else tuple(things)
        edit = Edit("name", things=ids, name=name, aliases=tuple(aliases))
        return self.edit_scene(scene_id, [edit], looked_at=looked_at)

    def split_thing(
        self,
        scene_id: str,
        thing: int,
        viewpoint: str | PosedCamera,
        *,
        pixels: Sequence[tuple[float, float]] = (),
        background: Sequence[tuple[float, float]] = (),
        box: tuple[float, float, float, float] | None = None,
        name: str | None = None,
        aliases: Sequence[str] = (),
        looked_at: str = "",
    ) -> SceneVersion:
        """Make a new version in which a piece of a thing is a thing of its own, see `SceneVersion.prompted`.

        Args:
            scene_id: which scene.
            thing: its id; it keeps what is left of it, and its name.
            viewpoint: one of the scene's own cameras (its name) or a free viewpoint.
            pixels: x, y on the piece in the viewpoint's picture; the middle of its first pixel is (0.5, 0.5).
            background: x, y beside the piece.
            box: left, top, right, bottom around the piece.
            name, aliases: of the new thing.
            looked_at: see `edit_scene`.
        """
        prompt = _prompt(viewpoint, pixels, background, box)
        edit = Edit("split", things=(thing,), prompt=prompt, name=name, aliases=tuple(aliases))
        return self.edit_scene(scene_id, [edit], looked_at=looked_at)

    def add_thing(
        self,
        scene_id: str,
        viewpoint: str | PosedCamera,
        *,
        pixels: Sequence[tuple[float, float]] = (),
        background: Sequence[tuple[float, float]] = (),
        box: tuple[float, float, float, float] | None = None,
        name: str | None = None,
        aliases: Sequence[str] = (),
        looked_at: str = "",
    ) -> SceneVersion:
        """Make a new version with a thing that was missing, whatever its Gaussians belonged to; see `split_thing`."""
        prompt = _prompt(viewpoint, pixels, background, box)
        edit = Edit("add", prompt=prompt, name=name, aliases=tuple(aliases))
        return self.edit_scene(scene_id, [edit], looked_at=looked_at)

    def edit_scene(
        self,
        scene_id: str,
        edits: Sequence[Edit],
        *,
        request_id: str = "",
        looked_at: str = "",
        timeout_s: float | None = None,
    ) -> SceneVersion:
        """Make a new version; it is current on return.

        Args:
            scene_id: which scene.
            edits: at least one, applied in order.
            request_id: the same id returns the version that it made; by default a new one.
            looked_at: the version that was looked at: only names that stood in it are replaced.
            timeout_s: when to give up.
        """
        body = to_plain(EditIn(tuple(edits), request_id or uuid.uuid4().hex, looked_at))
        return read(
            SceneVersion,
            self._transport.call("POST", f"{scene_path(scene_id)}:edit", json=body, timeout_s=timeout_s),
        )

    def look_again(self, scene_id: str, texts: str | Sequence[str], *, request_id: str = "") -> Operation:
        """Search a scene for more names with the server's open-set detector; the job is queued, durably, on return.

        Names that people or label maps gave stay. Once it has succeeded, `Operation.look_again` says what was found,
        and the scene has a new version.

        Args:
            scene_id: which scene.
            texts: what to look for, in plain words.
            request_id: the same id returns the same operation; by default a new one.
        """
        body = to_plain(
            LookAgainIn((texts,) if isinstance(texts, str) else tuple(texts), request_id or uuid.uuid4().hex)
        )
        return read(Operation, self._transport.call("POST", f"{scene_path(scene_id)}:lookAgain", json=body))

    def train_more(
        self,
        scene_id: str,
        *,
        seconds: float | None = None,
        steps: int | None = None,
        preset: PresetName | None = None,
        request_id: str = "",
    ) -> Operation:
        """Train a scene further, from its current version; the job is queued, durably, on return.

        Once it has succeeded, `Operation.train_more` says what came of it, and the scene has a new version with the
        same things and names. A job whose result would be worse by photos that it does not see fails, and changes
        nothing.

        Args:
            scene_id: which scene.
            seconds: of optimization.
            steps: of optimization, instead of seconds; with neither the preset's time.
            preset: size of the pictures and number of Gaussians; by default the server's.
            request_id: the same id returns the same operation; by default a new one.
        """
        body = to_plain(TrainMoreIn(seconds, steps, preset, request_id or uuid.uuid4().hex))
        return read(Operation, self._transport.call("POST", f"{scene_path(scene_id)}:trainMore", json=body))

    def align_scene(self, scene_id: str, alignment: Alignment, *, request_id: str = "") -> SceneVersion:
        """Put a scene into the frame of a map, as a new version; `Scene.alignment` says how well pairs fit."""
        body = to_plain(AlignIn(alignment, request_id or uuid.uuid4().hex))
        return read(SceneVersion, self._transport.call("POST", f"{scene_path(scene_id)}:align", json=body))

    def undo_edit(self, scene_id: str, version: str = "") -> SceneVersion:
        """Go back to the version before the current one; with `version`, only if that is the current one."""
        body = to_plain(UndoIn(version))
        return read(
            SceneVersion, self._transport.call("POST", f"{scene_path(scene_id)}:undo", json=body, repeatable=False)
        )

    def redo_edit(self, scene_id: str, version: str = "") -> SceneVersion:
        """Go forward to the version that was undone; with `version`, only if that is the current one."""
        body = to_plain(RedoIn(version))
        return read(
            SceneVersion, self._transport.call("POST", f"{scene_path(scene_id)}:redo", json=body, repeatable=False)
        )

    def restore_version(self, scene_id: str, version: str, *, expected: str = "") -> SceneVersion:
        """Make any version current; with `expected`, only if that is the current one. All others stay."""
        body = to_plain(RestoreIn(version, expected))
        return read(SceneVersion, self._transport.call("POST", f"{scene_path(scene_id)}:restore", json=body))

    def versions(self, scene_id: str) -> tuple[SceneVersion, ...]:
        """Every version, oldest first."""
        return self._get(VersionList, f"{scene_path(scene_id)}/versions").versions

    def _get(self, kind: type[T], path: str, params: dict[str, Any] | None = None, timeout_s: float | None = None) -> T:
        return read(kind, self._transport.call("GET", path, params=params, timeout_s=timeout_s))

    def _pages(self, kind: type[Any], path: str, params: dict[str, Any] | None = None) -> Iterator[Any]:
        token = ""
        while True:
            page = self._get(kind, path, {"page_size": _PAGE, **(params or {}), "page_token": token})
            yield from page[0]
            if not (token := page.next_page_token):
                return


def _prompt(
    viewpoint: str | PosedCamera,
    pixels: Sequence[tuple[float, float]],
    background: Sequence[tuple[float, float]],
    box: tuple[float, float, float, float] | None,
) -> ThingPrompt:
    return ThingPrompt(
        camera=None if isinstance(viewpoint, str) else viewpoint,
        view=viewpoint if isinstance(viewpoint, str) else None,
        pixels=tuple(Pixel(*pixel) for pixel in pixels),
        background=tuple(Pixel(*pixel) for pixel in background),
        box=None if box is None else PixelBox(*box),
    )


def scene_path(scene_id: str) -> str:
    """The path of a scene."""
    return f"/v1/scenes/{in_path(scene_id)}"


def in_path(name: str) -> str:
    """A name as one segment of a path."""
    return quote(name, safe="")
