"""Captures of one place in one frame: a scene is put where another one is, by its own photos."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.application.answering.localizing import Localizing
from fastsplat.service.application.answering.open_scenes import OpenScenes
from fastsplat.service.application.base.validate import check_request_id, check_texts
from fastsplat.service.application.editing.versions import Versions
from fastsplat.service.capture.photos.scene_photos import photo_path
from fastsplat.service.settings import Settings
from fastsplat.service.store.store import Store
from fastsplat_contract.align_messages import AlignToIn
from fastsplat_contract.camera import PosedCamera
from fastsplat_contract.errors import InvalidInputError, NotFoundError, NotReadyError
from fastsplat_contract.localize_messages import LocalizeRequest
from fastsplat_contract.places import Alignment, PointPair
from fastsplat_contract.poses import vector3
from fastsplat_contract.scenes import Edit, SceneVersion

if TYPE_CHECKING:  # torch loads when it is used
    from fastsplat.service.query.scene_index import SceneIndex

    Cameras = Sequence[tuple[PosedCamera, bytes]]

FEWEST_PHOTOS = 3
"""Of the scene that must find their place in the other, and of those whose surfaces must agree."""
_COLUMNS, _ROWS = 4, 3
"""Places of a photo that are compared."""
_SIDE = 256
_SURE = 0.3
"""As for landmarks, see `service.localization.landmarks`."""


class SharedFrame:
    """Alignments of one project's scenes to each other. Every method is safe from any thread.

    Args:
        store, scenes: of the project.
        settings: the server's.
        localizing: in these scenes.
        versions: of these scenes.
    """

    def __init__(
        self, store: Store, settings: Settings, scenes: OpenScenes, localizing: Localizing, versions: Versions
    ) -> None:
        self._store, self._settings, self._scenes = store, settings, scenes
        self._localizing, self._versions = localizing, versions

    def align(self, scene_id: str, request: AlignToIn, author: str = "") -> SceneVersion:
        """Put a scene into the frame of another one, as a new version.

        Its kept photos, evenly as many as one request may have, are localized in the other, each by itself. Where both
        scenes have a sure surface at the same place of such a photo, its two points are a pair, as `align` takes them:
        what has moved between the captures fits the others badly and does not count.

        Args:
            scene_id: which scene.
            request: the other one.
            author: the id of the key by which this is asked for; "" for none.

        Raises:
            NotFoundError: there is no such scene, or no such other one.
            NotReadyError: one is still being made, or no photos are kept with it, or the other's units are no meters.
            InvalidInputError: no other scene or the scene itself, or too few photos find their place, or too few places
                agree.
            ConflictError: as `Versions.edit`.
        """
        check_request_id(request.request_id)
        check_texts(request.other, "other")
        digest = hashlib.sha256(f"align to {request.other}".encode()).hexdigest()
        if not request.other:
            raise InvalidInputError("no other scene", field="other", hint="Name a scene of the same place.")
        if request.other == scene_id:
            raise InvalidInputError("a scene is in its own frame", field="other", hint="Name another scene.")
        version = self._scenes.finished(scene_id)
        earlier = self._store.versions.made_by(scene_id, request.request_id, digest)
        if earlier is not None:
            return self._versions.in_force(earlier)
        try:
            target = self._scenes.finished(request.other)
        except (NotFoundError, NotReadyError) as error:
            raise error.within("other") from error
        there = self._scenes.reading(request.other, target, lambda index, _: index)
        if there.scene.scale != "METRIC":
            raise NotReadyError(
                "the other scene has no meters, and a frame that is shared has them",
                field="other",
                hint="Scale it by a known length first.",
            )
        alignment = there.scene.alignment
        frame = request.other if alignment is None or not alignment.frame else alignment.frame
        own = self._scenes.reading(scene_id, version, lambda index, _: index)
        cameras = self._photos(scene_id, version, own)
        asked = LocalizeRequest(
            scene_id=request.other,
            photos=tuple(content for _, content in cameras),
            focals=tuple(posed.camera.fx for posed, _ in cameras),
            version=target,
        )
        answer = self._localizing.localize(asked)
        found = [
            (posed, photo.camera)
            for (posed, _), photo in zip(cameras, answer.photos, strict=True)
            if photo.camera is not None
        ]
        if len(found) < FEWEST_PHOTOS:
            raise _too_few(len(found), len(cameras), "find their place in the other")
        pairs = [_pairs(own, there, mine, other) for mine, other in found]
        _check_agreement(pairs, own.scene.scale != "METRIC", len(cameras))
        points = tuple(PointPair(vector3(a), vector3(b)) for each in pairs for a, b in each)
        edit = Edit("align", alignment=Alignment(frame, pairs=points))
        return self._versions.edit(scene_id, (edit,), request.request_id, "", author, digest)

    def _photos(self, scene_id: str, version: str, index: SceneIndex) -> Cameras:
        """Some of a version's cameras, of the size of their photos, and these."""
        from PIL import Image

        folder = self._scenes.folder(scene_id, version)
        kept = [
            (posed, path)
            for number, posed in enumerate(index.scene.cameras)
            if (path := photo_path(folder, number)).is_file()
        ]
        if not kept:
            raise NotReadyError("no photos are kept with this scene, by which it could be aligned", field="scene")
        most = min(self._settings.localization.max_photos, len(kept))
        chosen = []
        for row in np.linspace(0, len(kept) - 1, most).round().astype(int):
            posed, path = kept[row]
            with Image.open(path) as image:
                size = image.size
            chosen.append((replace(posed, camera=posed.camera.scaled_to(*size)), path.read_bytes()))
        return chosen


def _pairs(
    own: SceneIndex, there: SceneIndex, mine: PosedCamera, other: PosedCamera
) -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Points of both scenes at the same places of one photo, where both have a sure surface."""
    from fastsplat.service.localization.photometric_refinement import small_camera

    points = []
    for index, posed in ((own, small_camera(mine, _SIDE)), (there, small_camera(other, _SIDE))):
        seen, camera, pose = index.geometry(posed), posed.camera, posed.world_from_camera
        column, row = (
            each.ravel()
            for each in np.meshgrid(
                ((np.arange(_COLUMNS) + 0.5) * camera.width / _COLUMNS).astype(int),
                ((np.arange(_ROWS) + 0.5) * camera.height / _ROWS).astype(int),
            )
        )
        depth = np.where(seen.confidence[row, column] > _SURE, seen.median_depth[row, column], 0.0)
        local = camera.rays(column + 0.5, row + 0.5) * depth[:, None]
        points.append((depth > 0, local @ pose[:3, :3].T + pose[:3, 3]))
    (sure, first), (sure_too, second) = points
    return [(first[place], second[place]) for place in np.flatnonzero(sure & sure_too)]


def _check_agreement(
    pairs: Sequence[Sequence[tuple[NDArray[np.float64], NDArray[np.float64]]]], scaled: bool, photos: int
) -> None:
    from fastsplat.service.query.edits.aligning import fit_pairs

    owner = np.repeat(np.arange(len(pairs)), [len(each) for each in pairs])
    points = [np.array([pair[side] for each in pairs for pair in each]).reshape(-1, 3) for side in (0, 1)]
    try:
        fit = fit_pairs(points[0], points[1], scaled=scaled)
    except InvalidInputError as error:
        raise _too_few(0, photos, f"agree on where the scene is ({error.message})") from error
    agreeing = len(np.unique(owner[~fit.outliers]))
    if agreeing < max(FEWEST_PHOTOS, len(pairs) / 2):
        raise _too_few(agreeing, photos, "agree on where the scene is")


def _too_few(count: int, photos: int, what: str) -> InvalidInputError:
    return InvalidInputError(
        f"{count} of {photos} photos of the scene {what}",
        field="other",
        limit=f"{FEWEST_PHOTOS} photos or more",
        hint="Name a scene of the same place, with photos from where these were taken; or align by pairs of points.",
    )
