"""Cache of scenes' landmarks for photo localization."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from fastsplat.service.application.base.cache import LeastRecentlyUsed
from fastsplat.service.application.base.memory import MemoryBudget
from fastsplat.service.capture.photos.scene_photos import kept_lenses, photo_path
from fastsplat.service.capture.views.kept_photos import read_photo
from fastsplat.service.common.radial_lens import middle_lens
from fastsplat.service.localization.landmarks import (
    BYTES_PER_LANDMARK,
    KEYPOINTS_PER_PHOTO,
    MAX_LANDMARK_VIEWS,
    Landmarks,
    Photo,
    find_landmarks,
)
from fastsplat.service.localization.localization_settings import LocalizationSettings
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.store.blobs.blobs import Blobs
from fastsplat_contract.errors import NotReadyError
from fastsplat_contract.geometry.camera import PosedCamera

_KEPT = 2
"""Number of cached versions."""


class LandmarkCache:
    """Landmarks of recently used versions, until their memory is needed. Thread-safe."""

    def __init__(self, settings: LocalizationSettings, memory: MemoryBudget) -> None:
        self._settings = settings
        self._memory = memory
        self._lock = threading.Lock()
        self._counted = False
        self._kept: LeastRecentlyUsed[tuple[str, str], Landmarks] = LeastRecentlyUsed(_KEPT * self._largest)

    def of(self, scene_id: str, version: str, index: SceneIndex, folder: Path, blobs: Blobs) -> Landmarks:
        """Landmarks of a version; computing them takes some tenths of a second per photo.

        `blobs` checks the photos' digests.

        Raises:
            NotReadyError: the scene keeps no photos.
            SceneFileError: a photo is damaged.
        """

        def find() -> Landmarks:
            photos = photos_of(index.scene.cameras, folder, self._settings.max_side, blobs)
            lens = middle_lens(kept_lenses(folder))
            return find_landmarks(photos, index.geometry, lens)

        landmarks = self._kept.get((scene_id, version), lambda: self._largest, find)
        with self._lock:
            uncounted, self._counted = not self._counted, True
        if uncounted and not self._memory.keep(_KEPT * self._largest, self._drop):
            self._drop()
        return landmarks

    def forget(self, scene_id: str) -> None:
        """Drops one scene."""
        self._kept.drop(lambda key: key[0] == scene_id)

    @property
    def _largest(self) -> int:
        return BYTES_PER_LANDMARK * KEYPOINTS_PER_PHOTO * MAX_LANDMARK_VIEWS

    def _drop(self) -> None:
        with self._lock:
            self._counted = False
        self._kept.drop(lambda _: True)


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
