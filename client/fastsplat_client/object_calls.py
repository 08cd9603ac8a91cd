"""Calls about objects and versions."""

from __future__ import annotations

import uuid
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from fastsplat_client.table_calls import TableCalls
from fastsplat_contract import calls
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.geometry.object_prompts import ObjectPrompt
from fastsplat_contract.geometry.places import Alignment, KnownLength, KnownSize, Place
from fastsplat_contract.geometry.poses import Vector3
from fastsplat_contract.jobs.name_suggestions import AgreeIn, CaptionerStatus, SuggestedName
from fastsplat_contract.jobs.operations import Operation
from fastsplat_contract.messages import requests
from fastsplat_contract.messages.contact_sheets import ContactSheet
from fastsplat_contract.messages.detections import Detection, DetectionList
from fastsplat_contract.messages.edit_previews import EditPreview, PreviewEditRequest
from fastsplat_contract.messages.exports import ExportRequest
from fastsplat_contract.messages.goals import Goal
from fastsplat_contract.messages.known_names import KnownName
from fastsplat_contract.messages.measurements import Measurement, MeasureRequest
from fastsplat_contract.messages.objects import AskedLevel, PickedObject, PickRequest, Pixel, PixelBox, SceneObject
from fastsplat_contract.messages.scenes import Edit, SceneVersion

_EDITS = 100
"""The server's limit of edits per request."""


class ObjectCalls(TableCalls):
    """Object and version calls of `Client`."""

    def objects(self, scene_id: str, *, version: str = "", parts: bool = False) -> Iterator[SceneObject]:
        """Lists objects, named or not, by id; with `parts` each followed by its parts."""
        pages = self._pages(calls.LIST_OBJECTS, requests.ListObjectsRequest(scene_id, version, parts=parts))
        return (obj for page in pages for obj in page.objects)

    def object_ids(self, scene_id: str, *, version: str = "") -> NDArray[np.uint16]:
        """Gets the object id of each Gaussian: uint16 [G], 0 for none."""
        content = self.call(calls.EXPORT_SCENE, ExportRequest(scene_id, "objects", version))
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
    ) -> PickedObject:
        """Picks the object, part and group at a place, with one's mask.

        Args:
            viewpoint: a scene's camera (its name) or a free viewpoint; None for a point.
            pixel: x, y in the viewpoint's picture; its first pixel's center is (0.5, 0.5).
            box: left, top, right, bottom, instead of `pixel`.
            point: x, y, z in the world frame, instead of `pixel`.
            level: level of the masks: part, object, group, or the likeliest.
            mask3d: also return its Gaussians, see `decode_mask3d`.
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
        return self.call(calls.PICK_OBJECT, request)

    def measure(self, scene_id: str, *places: Place | int, version: str = "") -> Measurement:
        """Measures one place or object (its id), or the distance between two."""
        of = tuple(Place(object_id=place) if isinstance(place, int) else place for place in places)
        return self.call(calls.MEASURE_SCENE, MeasureRequest(scene_id, of, version))

    def goal(self, scene_id: str, object_id: int, robot_radius: float = 0.0, *, version: str = "") -> Goal:
        """Finds the nearest free place from which a robot sees an object or part.

        The scene must be in meters with z up; `robot_radius` is in meters, 0 means 0.2.
        """
        return self.call(calls.GET_GOAL, requests.GetGoalRequest(scene_id, version, object_id, robot_radius))

    def detections(self, scene_id: str, *, version: str = "") -> Iterator[Detection]:
        """Lists objects by id with pose, covariance, names, support and views, see `detection_page`."""
        pages = self._pages(calls.LIST_DETECTIONS, requests.ListDetectionsRequest(scene_id, version))
        return (detection for page in pages for detection in page.detections)

    def detection_page(self, scene_id: str, *, version: str = "", page_token: str = "") -> DetectionList:
        """Gets one page of `detections`, with frame, unit and up direction."""
        return self.call(
            calls.LIST_DETECTIONS, requests.ListDetectionsRequest(scene_id, version, page_token=page_token)
        )

    def scale_scene(self, scene_id: str, *known: KnownLength | KnownSize) -> SceneVersion:
        """Makes a metric version by known lengths and sizes, adding to earlier ones; see `Scene.scaling`."""
        lengths = tuple(length for length in known if isinstance(length, KnownLength))
        sizes = tuple(size for size in known if isinstance(size, KnownSize))
        return self.edit_scene(scene_id, [Edit("scale", known_lengths=lengths, known_sizes=sizes)])

    def name_objects(
        self,
        scene_id: str,
        objects: int | Sequence[int],
        name: str,
        *,
        aliases: Sequence[str] = (),
        kinds: Sequence[str] = (),
        looked_at: str = "",
    ) -> SceneVersion:
        """Names objects in a new version, see `edit_scene`.

        If the version has `asks_kind`, no word of the name is known; call again with `kinds` that say what it is.
        """
        ids = (objects,) if isinstance(objects, int) else tuple(objects)
        edit = Edit("name", object_ids=ids, name=name, aliases=tuple(aliases), kinds=tuple(kinds))
        return self.edit_scene(scene_id, [edit], looked_at=looked_at)

    def contact_sheets(self, scene_id: str, *, version: str = "") -> Iterator[ContactSheet]:
        """Yields pictures of unnamed objects, at most 20 each; `suggest_names` is allowed meanwhile."""
        return self._pages(calls.GET_CONTACT_SHEET, requests.GetContactSheetRequest(scene_id, version))

    def suggest_names(
        self, scene_id: str, suggestions: Sequence[SuggestedName], *, request_id: str = ""
    ) -> SceneVersion:
        """Suggests 1 to 1,000 names, queryable at once; `name_objects` or `confirm_names` confirms them.

        A source's new suggestions for an object replace its earlier ones. `request_id` makes the call idempotent.
        """
        request = requests.SuggestNamesRequest(scene_id, tuple(suggestions), request_id or uuid.uuid4().hex)
        return self.call(calls.SUGGEST_NAMES, request)

    def ask_captioner(self, scene_id: str, *, request_id: str = "") -> Operation:
        """Queues a job that asks the server's captioner about all unnamed objects.

        `Operation.ask_captioner` has its result. `request_id` makes the call idempotent.

        Raises:
            ModelUnavailableError: the server has no captioner.
            PermissionDeniedError: the project has not agreed, see `agree_to_captioner`.
        """
        return self.call(calls.ASK_CAPTIONER, requests.AskCaptionerRequest(scene_id, request_id or uuid.uuid4().hex))

    def agree_to_captioner(self, host: str) -> CaptionerStatus:
        """Lets the project send pictures of unnamed objects to `server_status().captioner.host`; "" revokes it."""
        return self.call(calls.AGREE_TO_CAPTIONER, AgreeIn(host))

    def confirm_names(self, scene_id: str, *, least: float = 0.8) -> tuple[SceneObject, ...]:
        """Gives unnamed objects their likeliest suggested name, if probable enough; returns them as before."""
        likely = [
            obj
            for obj in self.objects(scene_id)
            if not obj.name and obj.suggestions and obj.suggestions[0].probability >= least
        ]
        firsts = ((obj, obj.suggestions[0]) for obj in likely)
        edits = [Edit("name", object_ids=(obj.id,), name=first.name, aliases=first.aliases) for obj, first in firsts]
        for start in range(0, len(edits), _EDITS):
            self.edit_scene(scene_id, edits[start : start + _EDITS])
        return tuple(likely)

    def split_object(
        self,
        scene_id: str,
        object_id: int,
        viewpoint: str | PosedCamera,
        *,
        pixels: Sequence[tuple[float, float]] = (),
        background: Sequence[tuple[float, float]] = (),
        box: tuple[float, float, float, float] | None = None,
        name: str | None = None,
        aliases: Sequence[str] = (),
        looked_at: str = "",
    ) -> SceneVersion:
        """Splits a piece off an object in a new version, see `SceneVersion.prompted`.

        Args:
            object_id: its id; it keeps the rest and its name.
            viewpoint: a scene's camera (its name) or a free viewpoint.
            pixels: x, y on the piece in the viewpoint's picture; its first pixel's center is (0.5, 0.5).
            background: x, y beside the piece.
            box: left, top, right, bottom around the piece.
            name, aliases: of the new object.
            looked_at: see `edit_scene`.
        """
        prompt = _prompt(viewpoint, pixels, background, box)
        edit = Edit("split", object_ids=(object_id,), prompt=prompt, name=name, aliases=tuple(aliases))
        return self.edit_scene(scene_id, [edit], looked_at=looked_at)

    def add_object(
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
        """Adds a missing object in a new version, whatever its Gaussians belonged to; see `split_object`."""
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
        """Makes a new version, which becomes the current one.

        Args:
            edits: at least one, applied in order.
            request_id: makes the call idempotent; "": a new one.
            looked_at: the version that was shown; only names that stood in it are replaced.
        """
        request = requests.EditSceneRequest(scene_id, tuple(edits), request_id or uuid.uuid4().hex, looked_at)
        return self.call(calls.EDIT_SCENE, request, timeout_s=timeout_s)

    def preview_edit(self, scene_id: str, edits: Sequence[Edit], *, version: str = "") -> EditPreview:
        """Computes the Gaussians that edits with action remove would remove; changes nothing."""
        return self.call(calls.PREVIEW_EDIT, PreviewEditRequest(scene_id, tuple(edits), version))

    def look_again(self, scene_id: str, texts: str | Sequence[str], *, request_id: str = "") -> Operation:
        """Queues a job that searches a scene for objects by text with the open-set detector.

        Names by people or label maps are kept. The job makes a new version; `Operation.look_again` has its findings.
        `request_id` makes the call idempotent.
        """
        sought = (texts,) if isinstance(texts, str) else tuple(texts)
        return self.call(calls.LOOK_AGAIN, requests.LookAgainRequest(scene_id, sought, request_id or uuid.uuid4().hex))

    def align_scene(self, scene_id: str, alignment: Alignment, *, request_id: str = "") -> SceneVersion:
        """Aligns a scene to a map frame in a new version; `Scene.alignment` has the residuals."""
        return self.edit_scene(scene_id, [Edit("align", alignment=alignment)], request_id=request_id)

    def undo_edit(self, scene_id: str, version: str = "") -> SceneVersion:
        """Undoes the current version; with `version`, only if that is the current one."""
        return self.call(calls.UNDO_EDIT, requests.UndoEditRequest(scene_id, version))

    def redo_edit(self, scene_id: str, version: str = "") -> SceneVersion:
        """Redoes the undone version; with `version`, only if that is the current one."""
        return self.call(calls.REDO_EDIT, requests.RedoEditRequest(scene_id, version))

    def restore_version(self, scene_id: str, version: str, *, expected: str = "") -> SceneVersion:
        """Makes a version current; with `expected`, only if that is the current one."""
        return self.call(calls.RESTORE_VERSION, requests.RestoreVersionRequest(scene_id, version, expected))

    def versions(self, scene_id: str) -> tuple[SceneVersion, ...]:
        """Lists versions, oldest first."""
        return self.call(calls.LIST_VERSIONS, requests.ListVersionsRequest(scene_id)).versions


def _prompt(
    viewpoint: str | PosedCamera,
    pixels: Sequence[tuple[float, float]],
    background: Sequence[tuple[float, float]],
    box: tuple[float, float, float, float] | None,
) -> ObjectPrompt:
    return ObjectPrompt(
        camera=None if isinstance(viewpoint, str) else viewpoint,
        view=viewpoint if isinstance(viewpoint, str) else None,
        pixels=tuple(Pixel(*pixel) for pixel in pixels),
        background=tuple(Pixel(*pixel) for pixel in background),
        box=None if box is None else PixelBox(*box),
    )


class ClientKnownNames(TableCalls):
    """Known names of the client's project."""

    def all(self) -> Iterator[KnownName]:
        """Lists names given by people and suggested in other scenes, newest first."""
        pages = self._pages(calls.LIST_KNOWN_NAMES, requests.ListKnownNamesRequest())
        return (name for page in pages for name in page.names)

    def forget(self, name_id: str) -> None:
        """Deletes a known name ("all": every one) with its appearance; scenes keep their names."""
        self.call(calls.DELETE_KNOWN_NAME, requests.DeleteKnownNameRequest(name_id))
