"""Localization of decoded photos: poses, visible objects, and differences from the scene."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.application.answering.scene_changes import scene_changes
from fastsplat.service.capture.uploads.sent_photos import SentPhoto
from fastsplat.service.localization.acceptance import explanation_of
from fastsplat.service.localization.landmarks import Landmarks
from fastsplat.service.localization.photo_placement import Photo, PlacedPhoto, place_photos
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.geometry.object_prompts import PixelBox
from fastsplat_contract.photos.localization import Localization, LocalizedPhoto, ObjectInView, PhotoDifference


@dataclass(frozen=True)
class LocalizedPictures:
    """Localization results and the photos' pixels.

    Attributes:
        pictures: uint8 [H, W, 3] each, undistorted, as compared with the scene; None without a pose.
        taken_at: see `SentPhoto`.
    """

    answer: Localization
    pictures: tuple[NDArray[np.uint8] | None, ...]
    taken_at: tuple[float | None, ...]


_LEAST_SHARE = 0.001
_VIEW_SIDE = 256


def localized_photos(
    index: SceneIndex,
    landmarks: Landmarks,
    sent: Sequence[SentPhoto],
    focals: Sequence[float | None],
    rough: Sequence[NDArray[np.float64]],
    version: str,
) -> LocalizedPictures:
    """Localizes photos, in order, and finds changes on which two of them agree.

    Args:
        focals: pixels of each photo as sent; None: from the photo, or unknown.
        rough: float64 [4, 4] each, world from camera; one per photo, or none.
    """
    photos = [_photo(photo, focal) for photo, focal in zip(sent, focals, strict=True)]
    placed = place_photos(photos, landmarks, index.geometry, rough)
    changes, looked_at, differences = scene_changes(index, placed, [photo.size for photo in sent])
    answers = [
        _answer(index, photo, placement, differences.get(number, ()))
        for number, (photo, placement) in enumerate(zip(sent, placed, strict=True))
    ]
    answer = Localization(tuple(answers), changes, looked_at, index.scene.scale == "METRIC", version)
    pictures = tuple(None if placement.photo is None else placement.photo.picture for placement in placed)
    return LocalizedPictures(answer, pictures, tuple(photo.taken_at for photo in sent))


def _photo(sent: SentPhoto, focal: float | None) -> Photo:
    if focal is not None:
        return Photo(sent.pixels, focal / max(sent.size), "given")
    return Photo(sent.pixels, sent.focal, "metadata")


def _answer(
    index: SceneIndex, sent: SentPhoto, placed: PlacedPhoto, differences: tuple[PhotoDifference, ...]
) -> LocalizedPhoto:
    evidence = placed.evidence
    camera: PosedCamera | None = None
    objects: tuple[ObjectInView, ...] = ()
    if placed.posed is not None:
        lens = placed.posed.camera.scaled_to(*sent.size)
        camera = dataclasses.replace(placed.posed, camera=lens, frame_id=index.scene.frame_id)
        objects = _objects(index, camera)
    return LocalizedPhoto(
        refusal=placed.refusal,
        explanation=explanation_of(placed.refusal, evidence),
        camera=camera,
        radial=placed.radial,
        covariance=() if placed.covariance is None else tuple(placed.covariance.ravel().tolist()),
        focal_source=None if camera is None else placed.focal_source,
        inliers=evidence.inliers,
        inlier_share=evidence.inlier_share,
        spread=evidence.spread,
        agreement=evidence.agreement,
        refined=placed.refined,
        objects=objects,
        differences=differences,
    )


def _objects(index: SceneIndex, posed: PosedCamera) -> tuple[ObjectInView, ...]:
    small = posed.limited_to(_VIEW_SIDE)
    ids = index.objects.map(small)
    x, y = posed.camera.width / small.camera.width, posed.camera.height / small.camera.height
    seen = []
    for object_id, pixels in zip(*np.unique(ids[ids > 0], return_counts=True), strict=True):
        share = float(pixels / ids.size)
        if share < _LEAST_SHARE:
            continue
        rows, columns = np.nonzero(ids == object_id)
        box = PixelBox(columns.min() * x, rows.min() * y, (columns.max() + 1) * x, (rows.max() + 1) * y)
        seen.append(
            ObjectInView(int(object_id), index.objects.get(int(object_id)).name, share, PixelBox(*map(float, box)))
        )
    return tuple(sorted(seen, key=lambda obj: (-obj.share, obj.object_id)))
