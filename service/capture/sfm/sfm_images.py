"""Prepares photos, panoramas and video frames for structure from motion."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.formats.image_io import PhotoInfo, load_rgb, save_rgb
from fastsplat.service.capture.formats.reduced_images import reduced_size
from fastsplat.service.capture.formats.upload_manifest import UploadManifest
from fastsplat.service.capture.photos.lens_faces import LensFace, face_camera, face_name
from fastsplat.service.capture.photos.panorama import (
    PanoramaFrame,
    decoded_size,
    face_side,
    full_frame,
    nadir_mask,
    panorama_faces,
    shown_by_any,
    wrapped,
)
from fastsplat.service.capture.photos.photo_metadata import PhotoMetadata
from fastsplat.service.capture.photos.photo_quality import PhotoQuality, measure_photo
from fastsplat.service.capture.photos.withholding import WithheldPixels
from fastsplat.service.capture.untrusted.image_decoder import ImageDecoder
from fastsplat_contract.codec.json_codec import from_plain
from fastsplat_contract.errors import CorruptImageError, InvalidInputError, LimitExceededError
from fastsplat_contract.photos.photo_verdicts import NotPlaced

_FILM_DIAGONAL_MM = float(np.hypot(36.0, 24.0))
_FISHEYE_FOV_DEG = 120.0
"""Assumed without EXIF; from here, bundle adjustment finds 100° to 175°."""
_FACES_A_PANORAMA = 6


@dataclass(frozen=True)
class SfmImage:
    """An upright, reduced image for structure from motion."""

    name: str
    file: str  # below the work folder's images
    width: int  # of the reduced pixels
    height: int
    camera_group: str  # images of one group share a camera
    focal_px: float  # by EXIF; 0 if unknown
    photo: PhotoInfo | None  # source; None for a video's frame
    quality: PhotoQuality
    model: str = "SIMPLE_RADIAL"  # COLMAP's, assumed
    face: LensFace | None = None  # of a panorama
    panorama: PanoramaFrame | None = None  # source of a face
    metadata: PhotoMetadata = field(default_factory=PhotoMetadata)
    mask: NDArray[np.bool_] | None = None  # [H, W], false where pixels are ignored

    def to_request(self) -> dict[str, Any]:
        """Makes an entry of the request to `sfm.reconstruct`."""
        return {
            "file": self.file,
            "width": self.width,
            "height": self.height,
            "group": self.camera_group,
            "focal": self.focal_px,
            "model": self.model,
            "camera_from_face": None if self.face is None else self.face.camera_from_face.tolist(),
        }


def upright_photos(
    manifest: UploadManifest,
    files: Path,
    images: Path,
    settings: CaptureSettings,
    decoder: ImageDecoder,
    held: WithheldPixels,
    left_out: dict[str, NotPlaced],
) -> Iterator[SfmImage]:
    """Writes the images of an upload's photos below `images`, one by one; panoramas as faces.

    Unreadable photos are named in `left_out`; what `held` withholds in one face is withheld in all.

    Raises:
        InvalidInputError: a photo cannot be the stated panorama, or two views would have one name.
        LimitExceededError: more faces than `max_images`.
        ResourceError: as `ImageDecoder.photo`.
    """
    metadata = {
        photo.path: from_plain(PhotoMetadata, manifest.metadata.get(photo.path, {})) for photo in manifest.photos
    }
    frames = {photo.path: _frame(photo, metadata[photo.path], settings) for photo in manifest.photos}
    sides = [face_side(frame, settings.panorama_face_side) for frame in frames.values() if frame is not None]
    _check_count(len(frames) + (_FACES_A_PANORAMA - 1) * len(sides), settings)
    names = _Names(manifest.names if sides else ())
    for index, (photo, name) in enumerate(zip(manifest.photos, manifest.names, strict=True)):
        frame = frames[photo.path]
        size = (
            reduced_size(*photo.upright_size, settings.max_side) if frame is None else decoded_size(frame, min(sides))
        )
        try:
            pixels = decoder.photo(files, photo, size)
        except (CorruptImageError, LimitExceededError):
            left_out[name] = "unreadable"
            continue
        if frame is None:
            yield _photo(f"{index:05d}.png", photo, name, pixels, images, settings, held, metadata[photo.path])
        else:
            for image in _faces(pixels, frame, min(sides), f"{index:05d}.png", name, images, settings, held):
                yield replace(image, name=names.free(image.name), photo=photo, metadata=metadata[photo.path])


def frame_width(settings: CaptureSettings) -> int:
    """Computes the longer side of reduced video frames, pixels."""
    if settings.lens != "panorama":
        return settings.max_side
    return round(2 * np.pi * face_camera(settings.panorama_face_side).fx)


def video_frames(
    names: list[str],
    size: tuple[int, int],
    video: str,
    images: Path,
    settings: CaptureSettings,
    decoder: ImageDecoder,
    held: WithheldPixels,
) -> Iterator[SfmImage]:
    """Makes the images of a video's frames below `images`; 360° frames become faces.

    Raises:
        InvalidInputError: the video cannot be the stated panorama.
        LimitExceededError: more faces than `max_images`.
        CorruptImageError, ResourceError: as `ImageDecoder.photo`.
    """
    width, height = size
    frame = full_frame(video, width, height) if settings.lens == "panorama" else None
    _check_count(len(names) * (1 if frame is None else _FACES_A_PANORAMA), settings)
    for file in names:
        pixels = decoder.photo(images, frame_info(file, width, height), size)
        if frame is None:
            model, focal = _lens(size, 0.0, settings)
            pixels = held.take_frame(images / file, pixels)
            yield SfmImage(file, file, width, height, "video", focal, None, measure_photo(file, pixels), model)
        else:
            side = face_side(frame, settings.panorama_face_side)
            yield from _faces(pixels, frame, side, file, file, images, settings, held)
            (images / file).unlink()


def photo_ups(images: Sequence[SfmImage], world_from_camera: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Collects unit vectors up in the world, one per photo or panorama that has one."""
    ups: dict[str, NDArray[np.float64]] = {}
    for image, pose in zip(images, world_from_camera, strict=True):
        up, panorama = image.metadata.up, image.panorama
        if image.face is not None and panorama is not None and panorama.vertical is not None:
            there = image.face.camera_from_face.T @ panorama.vertical
            ups.setdefault(image.file.partition("/")[2], pose[:3, :3] @ there)
        elif image.face is None and up is not None:
            ups[image.file] = pose[:3, :3] @ np.array(up)
    return list(ups.values())


def source_pixels(image: SfmImage, images: Path, decoder: ImageDecoder) -> NDArray[np.uint8]:
    """Loads uint8 [H, W, 3] of an image; untrusted video frames by the decoder."""
    if image.photo is None and image.face is None:
        info = frame_info(image.file, image.width, image.height)
        return decoder.photo(images, info, (image.width, image.height))
    return load_rgb(images / image.file)


def source_ids(image: SfmImage, files: Path, name: str, decoder: ImageDecoder) -> NDArray[np.uint16]:
    """Loads label map `name` of an image's photo, uint16 [H, W], aligned with the image."""
    assert image.photo is not None
    if image.face is None or image.panorama is None:
        return decoder.ids(files, name, image.photo, (image.width, image.height))
    ids = decoder.ids(files, name, image.photo, decoded_size(image.panorama, image.width))
    return image.face.undistortion.apply_to_ids(wrapped(ids, image.panorama).astype(np.uint16))


def frame_info(file: str, width: int, height: int) -> PhotoInfo:
    """Makes the header of a video's frame."""
    return PhotoInfo(file, width, height, orientation=1, lens="", focal_35mm=0.0)


class _Names:
    """Hands out view names, each once."""

    def __init__(self, names: tuple[str, ...]) -> None:
        self._taken = set(names)

    def free(self, name: str) -> str:
        if name in self._taken:
            raise InvalidInputError(
                f"a face of a panorama would be called {name}, as another photo is",
                field=name,
                hint="Rename that photo.",
            )
        self._taken.add(name)
        return name


def _frame(photo: PhotoInfo, metadata: PhotoMetadata, settings: CaptureSettings) -> PanoramaFrame | None:
    if settings.lens == "fisheye":
        return None
    if metadata.frame is not None and photo.orientation == 1:
        stored = (metadata.frame.stored_width, metadata.frame.stored_height)
        if stored == (photo.width, photo.height):
            return metadata.frame
    return full_frame(photo.path, *photo.upright_size) if settings.lens == "panorama" else None


def _check_count(images: int, settings: CaptureSettings) -> None:
    if images > settings.max_images:
        raise LimitExceededError(
            f"the panoramas have {images} faces",
            field="files",
            limit=f"{settings.max_images} images (FASTSPLAT_CAPTURE__MAX_IMAGES)",
            hint="Send fewer panoramas: each becomes six images.",
        )


def _photo(
    file: str,
    photo: PhotoInfo,
    name: str,
    pixels: NDArray[np.uint8],
    images: Path,
    settings: CaptureSettings,
    held: WithheldPixels,
    metadata: PhotoMetadata,
) -> SfmImage:
    pixels = held.take(name, pixels, file).pixels
    save_rgb(pixels, images / file)
    height, width = pixels.shape[:2]
    model, focal_px = _lens((width, height), photo.focal_35mm, settings)
    group, quality = f"{photo.lens} {width}×{height}", measure_photo(name, pixels)
    return SfmImage(name, file, width, height, group, focal_px, photo, quality, model, metadata=metadata)


def _lens(size: tuple[int, int], focal_35mm: float, settings: CaptureSettings) -> tuple[str, float]:
    """Chooses COLMAP's model and initial focal length in pixels; 0: COLMAP's guess."""
    focal_px = focal_35mm / _FILM_DIAGONAL_MM * float(np.hypot(*size))
    if settings.lens != "fisheye":
        return "SIMPLE_RADIAL", focal_px
    return "OPENCV_FISHEYE", focal_px or max(size) / np.radians(_FISHEYE_FOV_DEG)


def _faces(
    pixels: NDArray[np.uint8],
    frame: PanoramaFrame,
    side: int,
    file: str,
    name: str,
    images: Path,
    settings: CaptureSettings,
    held: WithheldPixels,
) -> Iterator[SfmImage]:
    bordered, faces = wrapped(pixels, frame), {}
    face_images: list[SfmImage] = []
    for face in panorama_faces(frame, (pixels.shape[1], pixels.shape[0]), side):
        mask = face.undistortion.valid(bordered.shape[1], bordered.shape[0])
        nadir = nadir_mask(side, face.name, settings.nadir_deg)
        if nadir is not None:
            mask = nadir if mask is None else mask & nadir
        if mask is None or mask.any():
            faces[face.name] = face, mask, nadir, face.undistortion.apply(bordered)
    mover_masks = {face: mask for face, (*_, picture) in faces.items() if (mask := held.movers(picture)) is not None}
    movers = shown_by_any(mover_masks)
    for face, mask, nadir, picture in faces.values():
        folder = images / face.name
        folder.mkdir(exist_ok=True)
        view = face_name(name, face.name)
        picture = held.take(view, picture, f"{face.name}/{file}", movers.get(face.name)).pixels
        save_rgb(picture if nadir is None else np.where(nadir[..., None], picture, 0).astype(np.uint8), folder / file)
        image = SfmImage(
            name=view,
            file=f"{face.name}/{file}",
            width=side,
            height=side,
            camera_group=face.name,
            focal_px=face_camera(side).fx,
            photo=None,
            quality=measure_photo(view, picture),
            model="PINHOLE",
            face=face,
            panorama=frame,
            mask=mask,
        )
        face_images.append(image)
    # A ceiling is less sharp than a shelf even in a sharp panorama, so all faces share their quality.
    detail = _root_mean_square([image.quality.detail for image in face_images])
    contrast = _root_mean_square([image.quality.contrast for image in face_images])
    for image in face_images:
        yield replace(image, quality=replace(image.quality, detail=detail, contrast=contrast))


def _root_mean_square(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if values else 0.0
