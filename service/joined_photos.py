"""Photos of observations that join a scene's own: which can, as views that it is trained on, and where they stay.

They were placed, undistorted and kept when they were observed. Where one shows a change, nothing of it joins: there it
shows another state of the place than the scene's own photos do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from fastsplat.service.capture.formats.kept_capture import empty_border, valid_path
from fastsplat.service.capture.photos.scene_photos import observed_photo_path, photo_folder, photo_path
from fastsplat.service.capture.types import View
from fastsplat.service.common.atomic import link_or_copy
from fastsplat.service.scene.frames import frame_of
from fastsplat.service.scene.types import TAKEN_AT, Scene
from fastsplat_contract.camera import PosedCamera
from fastsplat_contract.errors import InvalidInputError, NotFoundError, NotReadyError, SceneFileError
from fastsplat_contract.localize_messages import PhotoDifference

_AROUND = 0.02
"""Share of a photo's longer side around the box of a change that joins as little: its rim and shadow."""
_ENOUGH = 0.5
"""Share of a photo that must be left."""


@dataclass(frozen=True)
class JoiningPhotos:
    """Photos that join a version of a scene, in their order.

    Attributes:
        cameras: of the photos, in the version's frame.
        paths: of their files, beside the version's own photos.
        changes: what each shows to have changed, boxes in pixels of its camera.
        taken_at: when they were taken, seconds since 1970, by the names of their cameras, as far as that is known.
        left_out: why others of the same observations do not join.
    """

    cameras: tuple[PosedCamera, ...]
    paths: tuple[Path, ...]
    changes: tuple[tuple[PhotoDifference, ...], ...]
    taken_at: dict[str, float]
    left_out: tuple[str, ...]


def joining_photos(scene: Scene, folder: Path, observations: Sequence[str]) -> JoiningPhotos:
    """The photos of some observations of a version, without those of which most shows changes.

    Args:
        scene: the version.
        folder: of the version.
        observations: their ids.

    Raises:
        NotFoundError: there is no such observation in this version.
        NotReadyError: its photos were not kept.
        InvalidInputError: one is named twice, has joined before, or no photo of all is left.
    """
    known, frame, names = {each.id: each for each in scene.observations}, frame_of(scene), set()
    cameras, paths, changes, taken_at, left_out = [], [], [], {}, []
    own = {posed.name for posed in scene.cameras}
    for place, name in enumerate(observations):
        field, observation = f"observations[{place}]", known.get(name)
        if observation is None:
            raise NotFoundError(
                f"no observation {name[:80]!r} in this version of the scene",
                field=field,
                hint="List the scene's observations.",
            )
        if name in names or any(joined_name(name, number) in own for number in range(len(observation.photos))):
            raise InvalidInputError(f"the photos of observation {name} join twice", field=field, hint="Name it once.")
        names.add(name)
        for number, photo in enumerate(observation.photos):
            path = observed_photo_path(folder, name, number)
            if not photo.view or not path.is_file():
                raise NotReadyError(
                    f"the photos of observation {name} are not kept",
                    field=field,
                    hint="Photos stay while FASTSPLAT_PHOTOS__KEEP is on, and nobody is left out of the scene's own.",
                )
            size = (photo.camera.camera.width, photo.camera.camera.height)
            if _unchanged(photo.differences, size, size).mean() < _ENOUGH:
                kinds = ", ".join(sorted({each.kind for each in photo.differences}))
                left_out.append(f"{photo.view}: most of it shows changes ({kinds})")
                continue
            changes.append(photo.differences)
            cameras.append(replace(frame.camera(photo.camera), name=joined_name(name, number)))
            paths.append(path)
            if observation.seen_at_source != "received":
                taken_at[cameras[-1].name] = observation.seen_at.timestamp()
    if observations and not cameras:
        raise InvalidInputError(
            "most of every photo of these observations shows changes",
            field="observations",
            hint="Make a new scene of newer photos: this one's own show another state of the place.",
        )
    return JoiningPhotos(tuple(cameras), tuple(paths), tuple(changes), taken_at, tuple(left_out))


def joined_name(observation_id: str, number: int) -> str:
    """The name of the camera of a photo that has joined, by its number in the observation."""
    return f"{observation_id}-{number:05d}.jpg"


def joined_views(joining: JoiningPhotos, scratch: Path) -> tuple[View, ...]:
    """The photos as views to be trained on.

    Args:
        joining: which.
        scratch: an existing folder for masks.

    Raises:
        SceneFileError: a photo is damaged.
    """
    views = []
    for number, (posed, path) in enumerate(zip(joining.cameras, joining.paths, strict=True)):
        size, mask = _content(joining, number)
        valid = None
        if not mask.all():
            valid = scratch / f"{posed.name}.valid.png"
            _write_mask(mask, valid)
        sized = PosedCamera(posed.camera.scaled_to(*size), posed.world_from_camera, posed.name)
        views.append(View(sized, path, valid))
    return tuple(views)


def keep_joined(joining: JoiningPhotos, target: Path, first: int) -> None:
    """Make the photos those of the scene, in the folder of a version that is not published yet.

    Args:
        joining: which.
        target: the folder.
        first: the number of the first one's camera.

    Raises:
        SceneFileError: a photo is damaged.
    """
    for place, path in enumerate(joining.paths):
        link_or_copy(path, photo_path(target, first + place))
        _, mask = _content(joining, place)
        if not mask.all():
            _write_mask(mask, valid_path(photo_folder(target), first + place))


def with_joined(scene: Scene, cameras: tuple[PosedCamera, ...], joining: JoiningPhotos) -> Scene:
    """The scene with the cameras of photos that have joined, in its own frame."""
    quality = dict(scene.quality)
    for name in ("images", "registered"):
        if isinstance(quality.get(name), int):
            quality[name] += len(cameras)
    if joining.taken_at:
        quality[TAKEN_AT] = {**(quality.get(TAKEN_AT) or {}), **joining.taken_at}
    return replace(scene, cameras=(*scene.cameras, *cameras), quality=quality)


def _content(joining: JoiningPhotos, number: int) -> tuple[tuple[int, int], NDArray[np.bool_]]:
    """Width and height of a photo, and bool [H, W], where it shows something, and no change."""
    path, camera = joining.paths[number], joining.cameras[number].camera
    try:
        with Image.open(path) as image:
            there = empty_border(np.asarray(image.convert("RGB")))
            unchanged = _unchanged(joining.changes[number], (camera.width, camera.height), image.size)
            return image.size, there & unchanged
    except OSError as error:
        raise SceneFileError(f"the photo {path.name} is damaged", field=path.name) from error


def _unchanged(changes: Sequence[PhotoDifference], whole: tuple[int, int], size: tuple[int, int]) -> NDArray[np.bool_]:
    """bool [H, W] of a picture of this size (width, height): what lies in no box of a change, which are in pixels of
    the whole size."""
    result = np.ones(size[::-1], np.bool_)
    scale, around = size[0] / whole[0], _AROUND * max(size)
    for box in (each.box for each in changes):
        top, left = (max(0, int(edge * scale - around)) for edge in (box.top, box.left))
        bottom, right = (int(edge * scale + around) + 1 for edge in (box.bottom, box.right))
        result[top:bottom, left:right] = False
    return result


def _write_mask(mask: NDArray[np.bool_], path: Path) -> None:
    Image.fromarray(np.where(mask, np.uint8(255), np.uint8(0))).save(path)
