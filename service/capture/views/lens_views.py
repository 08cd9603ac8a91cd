"""Turns an image into its views: one, or the faces of a fisheye lens."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.formats.image_io import PhotoInfo
from fastsplat.service.capture.photos.camera_model import rotate90, rotate90_pose
from fastsplat.service.capture.photos.lens_faces import FACES, WideLens, face_name, lens_of
from fastsplat.service.capture.photos.photo_metadata import PhotoPlace
from fastsplat.service.capture.photos.photo_quality import PhotoMatches, PhotoQuality
from fastsplat.service.capture.sfm.sfm_images import SfmImage
from fastsplat.service.capture.uploads.posed_input import PosedImage
from fastsplat.service.capture.views.view_writer import SourceImage, ViewGeometry, reduced_camera
from fastsplat.service.common.file_names import list_names
from fastsplat_contract.photos.photo_verdicts import NotPlaced

F64 = NDArray[np.float64]


@dataclass
class ViewLog:
    """Records lenses, and data for verdicts, while views are made."""

    lenses: dict[tuple[int, int], float] = field(default_factory=dict)  # covered shares by face count and degrees
    qualities: list[PhotoQuality] = field(default_factory=list)  # one a view
    matches: dict[str, PhotoMatches] = field(default_factory=dict)  # by view, without given poses
    place_of: dict[str, PhotoPlace] = field(default_factory=dict)  # by first view of each photo with a place
    unused_depths: int = 0  # depth maps of fisheye photos
    left_out: dict[str, NotPlaced] = field(default_factory=dict)  # by name
    broken_maps: list[str] = field(default_factory=list)  # unreadable label and depth maps
    _photos: set[str] = field(default_factory=set)

    def add(
        self, lens: WideLens, quality: PhotoQuality, matches: PhotoMatches | None = None, image: SfmImage | None = None
    ) -> None:
        """Records an image before it becomes the views of a lens's faces."""
        if lens.field_of_view_deg:
            self.lenses[len(lens.faces), round(lens.field_of_view_deg)] = lens.covered
        for face in lens.faces:
            name = face_name(quality.name, face.name)
            self.qualities.append(replace(quality, name=name))
            if matches is not None:
                self.matches[name] = matches

        photo = None if image is None else image.photo
        if image is not None and photo is not None and image.metadata.place and photo.path not in self._photos:
            self._photos.add(photo.path)
            self.place_of[face_name(quality.name, lens.faces[0].name)] = image.metadata.place

    def places(self, views: Sequence[str]) -> list[PhotoPlace | None]:
        """Looks up each view's place, once a photo."""
        return [self.place_of.get(view) for view in views]

    def warnings(self) -> tuple[str, ...]:
        """Makes sentences for people about fisheye photos and unused maps."""
        sentences = [_sentence(faces, angle, share) for (faces, angle), share in sorted(self.lenses.items())]
        if self.unused_depths:
            sentences.append(f"The depth maps of {self.unused_depths} fisheye photos are not used.")
        if self.broken_maps:
            count, names = len(self.broken_maps), list_names(self.broken_maps)
            sentences.append(f"{count} label or depth maps cannot be read and are not used: {names}.")
        return tuple(sentences)


def posed_lens(image: PosedImage, photo: PhotoInfo, settings: CaptureSettings) -> tuple[WideLens, list[ViewGeometry]]:
    """Computes the lens of a posed image and the geometry of its faces' views.

    Raises:
        InvalidInputError: the distortion cannot be undone.
    """
    stored, turns, size = reduced_camera(image, photo, settings)
    lens = lens_of(stored, settings.max_side, field=image.name)
    geometries = [
        ViewGeometry(
            size=size,
            undistortion=rotate90(face.undistortion, turns, stored.width, stored.height),
            world_from_camera=rotate90_pose(face.pose(image.world_from_camera), turns),
        )
        for face in lens.faces
    ]
    return lens, geometries


def views_of(source: SourceImage, lens: WideLens) -> list[SourceImage]:
    """Splits an image into the views of a lens's faces, with their undistortions."""
    return [
        replace(
            source,
            name=face_name(source.name, face.name),
            undistortion=face.undistortion,
            world_from_camera=face.pose(source.world_from_camera),
        )
        for face in lens.faces
    ]


def test_views(names: Sequence[str], views: Sequence[str]) -> tuple[str, ...]:
    """Lists the views of test images, including all faces of fisheye photos."""
    faces: Mapping[str, list[str]] = {name: [name, *(face_name(name, face) for face in FACES)] for name in names}
    present = set(views)
    return tuple(face for name in names for face in faces[name] if face in present)


def _sentence(faces: int, angle: int, share: float) -> str:
    shapes = "one view without distortion" if faces == 1 else f"{faces} views without distortion"
    rest = "" if share > 0.995 else f"; {100 * (1 - share):.0f} % of its pixels, at the rim, are not used"
    return f"Each fisheye photo of {angle}° becomes {shapes}{rest}."
