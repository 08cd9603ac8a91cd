"""The calls about things and versions: listed, picked, named, edited, undone."""

from __future__ import annotations

import uuid
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from fastsplat_client.table_calls import TableCalls
from fastsplat_contract import calls
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.geometry.places import Alignment, KnownLength, KnownSize, Place
from fastsplat_contract.geometry.poses import Vector3
from fastsplat_contract.geometry.thing_prompts import ThingPrompt
from fastsplat_contract.jobs.name_suggestions import AgreeIn, NamerStatus, SuggestedName
from fastsplat_contract.jobs.operations import Operation
from fastsplat_contract.messages import requests
from fastsplat_contract.messages.detections import Detection, DetectionList
from fastsplat_contract.messages.edit_previews import EditPreview, PreviewEditRequest
from fastsplat_contract.messages.exports import ExportRequest
from fastsplat_contract.messages.goals import Goal
from fastsplat_contract.messages.measurements import Measurement, MeasureRequest
from fastsplat_contract.messages.scenes import Edit, SceneVersion
from fastsplat_contract.messages.thing_sheets import ThingSheet
from fastsplat_contract.messages.things import AskedLevel, PickedThing, PickRequest, Pixel, PixelBox, SceneThing

_EDITS = 100
"""In one request, as the server takes them."""
"""Of the server's namer, drawing what it is shown included: as long as the server lets a call run."""


class ThingCalls(TableCalls):
    """The part of `Client` that speaks of things and versions."""

    def things(self, scene_id: str, *, version: str = "", parts: bool = False) -> Iterator[SceneThing]:
        """Every thing of a scene, with or without a name, by id; with `parts` each followed by its parts."""
        pages = self._pages(calls.LIST_THINGS, requests.ListThingsRequest(scene_id, version, parts=parts))
        return (thing for page in pages for thing in page.things)

    def thing_ids(self, scene_id: str, *, version: str = "") -> NDArray[np.uint16]:
        """uint16 [G]: which thing each Gaussian belongs to, by row; 0 for none."""
        content = self.call(calls.EXPORT_SCENE, ExportRequest(scene_id, "things", version))
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
        level: AskedLevel = "likeliest",
        mask3d: bool = False,
    ) -> PickedThing:
        """The thing at a place, the part of it there and the group that it is in, with the mask of one of these.

        Args:
            viewpoint: one of the scene's own cameras (its name) or a free viewpoint; None for a point.
            pixel: x, y in the viewpoint's picture; the middle of its first pixel is (0.5, 0.5).
            box: left, top, right, bottom, instead of `pixel`.
            point: x, y, z in the world frame, instead of `pixel`.
            version: of the scene; "" is the current one.
            level: what the masks show: part, thing, group, or what is likeliest meant.
            mask3d: whether to answer the Gaussians of it as well, see `decode_mask3d`.
        """
        request = PickRequest(
            scene_id,
            camera=None if isinstance(viewpoint, str) else viewpoint,
            view=viewpoint if isinstance(viewpoint, str) else None,
            pixel=None if pixel is None else Pixel(*pixel),
            box=None if box is None else PixelBox(*box),
            point=None if point is None else Vector3(*point),
            version=version,
            level=level,
            mask3d=mask3d,
        )
        return self.call(calls.PICK_THING, request)

    def measure(self, scene_id: str, *places: Place | int, version: str = "") -> Measurement:
        """Where one place is, how large one thing is, or how far two places are from each other.

        Args:
            places: one or two; a number is the id of a thing.
            version: of the scene; "" is the current one.
        """
        of = tuple(Place(thing=one) if isinstance(one, int) else one for one in places)
        return self.call(calls.MEASURE_SCENE, MeasureRequest(scene_id, of, version))

    def goal(self, scene_id: str, thing_id: int, robot_radius: float = 0.0, *, version: str = "") -> Goal:
        """The free place nearest to a thing from which a robot sees it; of scenes in meters with z up.

        Args:
            thing_id: of a thing or a part.
            robot_radius: meters; 0: 0.2.
            version: of the scene; "" is the current one.
        """
        return self.call(calls.GET_GOAL, requests.GetGoalRequest(scene_id, version, thing_id, robot_radius))

    def detections(self, scene_id: str, *, version: str = "") -> Iterator[Detection]:
        """Every thing of a scene as a robot needs it, by id: pose and covariance, names, what carries it, who saw it.
        Frame and unit say the pages of `detection_page`."""
        pages = self._pages(calls.LIST_DETECTIONS, requests.ListDetectionsRequest(scene_id, version))
        return (detection for page in pages for detection in page.detections)

    def detection_page(self, scene_id: str, *, version: str = "", page_token: str = "") -> DetectionList:
        """One page of `detections`, with their frame, their unit and what is up."""
        return self.call(
            calls.LIST_DETECTIONS, requests.ListDetectionsRequest(scene_id, version, page_token=page_token)
        )

    def scale_scene(self, scene_id: str, *known: KnownLength | KnownSize) -> SceneVersion:
        """Make a new version whose units are meters by these lengths, these sizes of things, and those of before, see
        `Scene.scaling`."""
        lengths = tuple(each for each in known if isinstance(each, KnownLength))
        sizes = tuple(each for each in known if isinstance(each, KnownSize))
        return self.edit_scene(scene_id, [Edit("scale", known_lengths=lengths, known_sizes=sizes)])

    def name_things(
        self,
        scene_id: str,
        things: int | Sequence[int],
        name: str,
        *,
        aliases: Sequence[str] = (),
        kinds: Sequence[str] = (),
        looked_at: str = "",
    ) -> SceneVersion:
        """Make a new version in which these things have a name; see `edit_scene`.

        Where it says `asks_kind`, no word of the name is known: `kinds` say what it is, in another such call.
        """
        ids = (things,) if isinstance(things, int) else tuple(things)
        edit = Edit("name", things=ids, name=name, aliases=tuple(aliases), kinds=tuple(kinds))
        return self.edit_scene(scene_id, [edit], looked_at=looked_at)

    def thing_sheets(self, scene_id: str, *, version: str = "") -> Iterator[ThingSheet]:
        """Pictures of all things without a name, of at most 20 each, see `ThingSheet`; for whoever can tell what they
        are and says so by `suggest_names`, also between two sheets."""
        return self._pages(calls.GET_THING_SHEET, requests.GetThingSheetRequest(scene_id, version))

    def suggest_names(
        self, scene_id: str, suggestions: Sequence[SuggestedName], *, request_id: str = ""
    ) -> SceneVersion:
        """Suggest names for things, see `SuggestedName`: they can be asked for, and nothing bears them until somebody
        gives them, by `name_things` or `confirm_names`.

        Args:
            suggestions: 1 to 1,000; what a source says of a thing replaces what it said before.
            request_id: the same id returns the version that it made; by default a new one.
        """
        request = requests.SuggestNamesRequest(scene_id, tuple(suggestions), request_id or uuid.uuid4().hex)
        return self.call(calls.SUGGEST_NAMES, request)

    def ask_namer(self, scene_id: str, *, request_id: str = "") -> Operation:
        """Ask the server's namer about all things without a name; the job is queued, durably, on return. Once it has
        succeeded, `Operation.ask_namer` says what came of it. The project agrees to the namer's host first, see
        `agree_to_namer`.

        Args:
            request_id: the same id returns the same operation; by default a new one.

        Raises:
            ModelUnavailableError: the server has no namer.
            PermissionDeniedError: the project did not agree.
        """
        return self.call(calls.ASK_NAMER, requests.AskNamerRequest(scene_id, request_id or uuid.uuid4().hex))

    def agree_to_namer(self, host: str) -> NamerStatus:
        """Agree, once for the project, that pictures of its things without a name go to the host of the server's namer
        (`server_status().namer.host`) when somebody asks it; "" takes that back."""
        return self.call(calls.AGREE_TO_NAMER, AgreeIn(host))

    def confirm_names(self, scene_id: str, *, least: float = 0.8) -> tuple[SceneThing, ...]:
        """Give every thing without a name the likeliest one that is suggested for it, from a probability on: a person's
        word, as by `name_things`. Returns these things as they were.
        """
        likely = [
            thing
            for thing in self.things(scene_id)
            if not thing.name and thing.suggestions and thing.suggestions[0].probability >= least
        ]
        firsts = ((thing, thing.suggestions[0]) for thing in likely)
        edits = [Edit("name", things=(thing.id,), name=told.name, aliases=told.aliases) for thing, told in firsts]
        for start in range(0, len(edits), _EDITS):
            self.edit_scene(scene_id, edits[start : start + _EDITS])
        return tuple(likely)

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
            edits: at least one, applied in order.
            request_id: the same id returns the version that it made; by default a new one.
            looked_at: the version that was looked at: only names that stood in it are replaced.
            timeout_s: when to give up.
        """
        request = requests.EditSceneRequest(scene_id, tuple(edits), request_id or uuid.uuid4().hex, looked_at)
        return self.call(calls.EDIT_SCENE, request, timeout_s=timeout_s)

    def preview_edit(self, scene_id: str, edits: Sequence[Edit], *, version: str = "") -> EditPreview:
        """Which Gaussians edits, whose action is remove, would remove from a version, "" the current one; nothing is
        changed."""
        return self.call(calls.PREVIEW_EDIT, PreviewEditRequest(scene_id, tuple(edits), version))

    def look_again(self, scene_id: str, texts: str | Sequence[str], *, request_id: str = "") -> Operation:
        """Search a scene for more names with the server's open-set detector; the job is queued, durably, on return.

        Names that people or label maps gave stay. Once it has succeeded, `Operation.look_again` says what was found,
        and the scene has a new version.

        Args:
            texts: what to look for, in plain words.
            request_id: the same id returns the same operation; by default a new one.
        """
        sought = (texts,) if isinstance(texts, str) else tuple(texts)
        return self.call(calls.LOOK_AGAIN, requests.LookAgainRequest(scene_id, sought, request_id or uuid.uuid4().hex))

    def align_scene(self, scene_id: str, alignment: Alignment, *, request_id: str = "") -> SceneVersion:
        """Put a scene into the frame of a map, as a new version; `Scene.alignment` says how well pairs fit."""
        return self.edit_scene(scene_id, [Edit("align", alignment=alignment)], request_id=request_id)

    def undo_edit(self, scene_id: str, version: str = "") -> SceneVersion:
        """Go back to the version before the current one; with `version`, only if that is the current one."""
        return self.call(calls.UNDO_EDIT, requests.UndoEditRequest(scene_id, version))

    def redo_edit(self, scene_id: str, version: str = "") -> SceneVersion:
        """Go forward to the version that was undone; with `version`, only if that is the current one."""
        return self.call(calls.REDO_EDIT, requests.RedoEditRequest(scene_id, version))

    def restore_version(self, scene_id: str, version: str, *, expected: str = "") -> SceneVersion:
        """Make any version current; with `expected`, only if that is the current one. All others stay."""
        return self.call(calls.RESTORE_VERSION, requests.RestoreVersionRequest(scene_id, version, expected))

    def versions(self, scene_id: str) -> tuple[SceneVersion, ...]:
        """Every version, oldest first."""
        return self.call(calls.LIST_VERSIONS, requests.ListVersionsRequest(scene_id)).versions


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
