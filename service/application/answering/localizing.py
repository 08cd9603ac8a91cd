"""Photo localization requests: validation, memory, and answer."""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fastsplat.service.application.answering.project_context import ProjectContext
from fastsplat.service.application.base.cache import BudgetedCache
from fastsplat.service.application.base.memory import picture_bytes
from fastsplat.service.application.base.validate import check_texts
from fastsplat.service.capture.photos.scene_photos import kept_lenses, photo_path, read_photo
from fastsplat.service.capture.uploads.sent_photos import DECODER_BYTES, SparePhotoDecoder
from fastsplat.service.common.radial_lens import middle_lens
from fastsplat.service.localization.landmarks import (
    BYTES_PER_LANDMARK,
    KEYPOINTS_PER_PHOTO,
    MAX_LANDMARK_VIEWS,
    Landmarks,
    Photo,
    find_landmarks,
)
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.settings import Settings
from fastsplat.service.store.blobs.blobs import Blobs
from fastsplat_contract.errors import InvalidInputError, LimitExceededError, NotReadyError
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from fastsplat_contract.photos.localization import Localization, LocalizeRequest

if TYPE_CHECKING:  # torch and pycolmap load when they are used
    from fastsplat.service.application.answering.localized_photos import LocalizedPictures
    from fastsplat.service.query.scene_index import SceneIndex

    Located = tuple[SceneIndex, LocalizedPictures]


MAX_PHOTOS_BYTES = 32 * 2**20
"""Limit of all photos of a REST request; gRPC messages have at most 4 MiB."""

_WORK_BYTES = 192 << 20
"""Keypoints and matches of one photo at a time, at the default sizes."""

_VERSIONS = 2
"""Number of cached versions."""
_LARGEST = BYTES_PER_LANDMARK * KEYPOINTS_PER_PHOTO * MAX_LANDMARK_VIEWS
"""Bytes of a version's landmarks."""


class Localizing:
    """Localization of photos in finished scenes. Thread-safe."""

    def __init__(self, context: ProjectContext) -> None:
        self._context = context
        self._landmarks: BudgetedCache[tuple[str, str], Landmarks] = BudgetedCache(_VERSIONS * _LARGEST, context.memory)
        self._decoder = SparePhotoDecoder(context.settings.capture)

    def over(self, context: ProjectContext) -> Localizing:
        """Same caches for another view of the store."""
        clone = copy.copy(self)
        clone._context = context
        return clone

    def close(self) -> None:
        """Stops the spare decoder."""
        self._decoder.close()

    def forget(self, scene_id: str) -> None:
        """Drops one scene."""
        self._landmarks.drop(lambda key: key[0] == scene_id)

    def localize(self, request: LocalizeRequest) -> Localization:
        """Localizes photos: pose, visible objects, and differences from the scene.

        A photo without a reliable pose gets a refusal with its reason.

        Raises:
            NotFoundError: no such scene or version.
            NotReadyError: it is still being made, or keeps no photos.
            InvalidInputError: no photo, an empty or damaged one, or invalid or mismatched focal lengths or poses.
            LimitExceededError: too many photos, or too large ones.
            ResourceError: decoding a photo exceeded its limits.
        """
        return self.locate(request)[1].answer

    def locate(self, request: LocalizeRequest) -> Located:
        """As `localize`, with the scene's index and the photos' pixels."""
        from fastsplat.service.application.answering.localized_photos import localized_photos

        check_photos(request, self._context.settings)
        side = self._context.settings.localization.max_side
        square = Camera(side, side, float(side), float(side), side / 2, side / 2)

        try:
            index, version = self._context.scenes.open(request.scene_id, request.version)
            gaussians = len(index.scene.gaussians)
            picture = picture_bytes("confidence", PosedCamera(square, np.eye(4)), gaussians)
            with self._context.memory.reserve(picture + _WORK_BYTES + DECODER_BYTES, "photos"):
                folder = self._context.scenes.folder(request.scene_id, version)
                landmarks = self._landmarks.get(
                    (request.scene_id, version), lambda: _LARGEST, lambda: self._found(index, folder)
                )
                self._landmarks.count()
                sent = self._decoder.decode(request.photos, side)
                rough = [pose.matrix() for pose in request.poses]
                focals = list(request.focals or [None])
                focals *= len(request.photos) if len(focals) == 1 else 1
                return index, localized_photos(index, landmarks, sent, focals, rough, version)
        finally:
            self._prepare()

    def _found(self, index: SceneIndex, folder: Path) -> Landmarks:
        """Landmarks of a version; takes some tenths of a second per photo, and raises as `photos_of`."""
        side = self._context.settings.localization.max_side
        photos = photos_of(index.scene.cameras, folder, side, self._context.store.blobs)
        return find_landmarks(photos, index.geometry, middle_lens(kept_lenses(folder)))

    def _prepare(self) -> None:
        if self._decoder.prepare() and not self._context.memory.keep(DECODER_BYTES, self._decoder.drop):
            self._decoder.drop()


def check_photos(request: LocalizeRequest, settings: Settings) -> None:
    """Validates a request without decoding photos; errors name the field."""
    check_texts(request.version, "version")
    limits, count = settings.localization, len(request.photos)
    if not count:
        raise InvalidInputError("no photos", field="photos", hint="Send one or more image files.")
    if count > limits.max_photos:
        raise LimitExceededError(
            f"{count} photos",
            field="photos",
            limit=f"{limits.max_photos} photos (FASTSPLAT_LOCALIZATION__MAX_PHOTOS)",
            hint="Send them in several requests.",
        )
    for number, photo in enumerate(request.photos):
        if not photo:
            raise InvalidInputError("an empty file", field=f"photos[{number}]", hint="Send the bytes of an image file.")
    size = sum(map(len, request.photos))
    if size > MAX_PHOTOS_BYTES:
        raise too_many_bytes(size)
    if len(request.focals) not in (0, 1, count):
        raise InvalidInputError(
            f"{len(request.focals)} focal lengths for {count} photos",
            field="focals",
            hint="Send one for each photo, one for all, or none.",
        )
    for number, focal in enumerate(request.focals):
        if not (math.isfinite(focal) and focal > 0):
            raise InvalidInputError(
                f"a focal length of {focal:g} pixels", field=f"focals[{number}]", hint="Send pixels, above 0."
            )
    if len(request.poses) not in (0, count):
        raise InvalidInputError(
            f"{len(request.poses)} poses for {count} photos", field="poses", hint="Send one for each photo, or none."
        )
    for number, pose in enumerate(request.poses):
        if not all(map(math.isfinite, (*pose.position, *pose.orientation))):
            raise InvalidInputError(
                "a pose with NaN or infinity", field=f"poses[{number}]", hint="Send finite numbers."
            )


def too_many_bytes(size: int) -> LimitExceededError:
    """Error for photos over `MAX_PHOTOS_BYTES`."""
    return LimitExceededError(
        f"photos of {size} bytes",
        field="photos",
        limit=f"{MAX_PHOTOS_BYTES} bytes, all photos together",
        hint="Send smaller versions: 1,600 pixels are enough.",
    )


def photos_of(cameras: Sequence[PosedCamera], folder: Path, side: int, blobs: Blobs | None = None) -> list[Photo]:
    """Lazy readers of a version's kept photos, downscaled to `side` pixels (longer side).

    Raises:
        NotReadyError: there are none.
        SceneFileError: one is damaged; checked by `blobs`, if given.
    """
    paths = [(posed, photo_path(folder, number)) for number, posed in enumerate(cameras)]
    there = [(posed, path) for posed, path in paths if path.is_file()]
    if not there:
        raise NotReadyError(
            "no photos are kept with this scene, so that others cannot find their place in it",
            field="scene",
            hint="Photos stay with scenes that are made of photos while FASTSPLAT_PHOTOS__KEEP is on.",
        )
    if blobs is not None:
        blobs.check_version(folder, *(path.relative_to(folder).as_posix() for _, path in there))
    return [(posed, partial(read_photo, path, side)) for posed, path in there]
