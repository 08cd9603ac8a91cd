"""Prepares placed photos as views; a faulty photo or map costs only itself."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.formats.depth_files import DepthFile
from fastsplat.service.capture.formats.depth_maps import F32
from fastsplat.service.capture.formats.image_io import PhotoInfo
from fastsplat.service.capture.formats.upload_manifest import UploadManifest
from fastsplat.service.capture.photos.camera_model import (
    CameraModel,
    check_camera_model,
    compute_undistortion,
    rotate90,
)
from fastsplat.service.capture.photos.lens_faces import face_name, is_fisheye, lens_of
from fastsplat.service.capture.photos.photo_quality import PhotoMatches, measure_photo
from fastsplat.service.capture.photos.withholding import WithheldPixels, both_masks
from fastsplat.service.capture.sfm.sfm_images import SfmImage, source_ids, source_pixels
from fastsplat.service.capture.untrusted.image_decoder import ImageDecoder
from fastsplat.service.capture.uploads.label_maps import LabelTable
from fastsplat.service.capture.uploads.posed_input import PosedImage
from fastsplat.service.capture.views.lens_views import ViewLog, posed_lens, views_of
from fastsplat.service.capture.views.view_writer import SourceImage
from fastsplat_contract.errors import InvalidInputError, LimitExceededError
from fastsplat_contract.geometry.camera import Camera

MAX_SIDE = 640  # of a stored depth map, pixels; training reads photos no more closely
_BROKEN = (InvalidInputError, LimitExceededError)  # errors of `ImageDecoder` due to the file


@dataclass(frozen=True)
class ViewSources:
    """Prepares the source images of a capture's views."""

    manifest: UploadManifest
    files: Path
    images: Path  # folder of the images for structure from motion
    settings: CaptureSettings
    decoder: ImageDecoder
    held: WithheldPixels
    table: LabelTable | None
    log: ViewLog

    def reconstructed(
        self, image: SfmImage, pose: NDArray[np.float64], camera: list[Any], matches: PhotoMatches
    ) -> Iterator[SourceImage]:
        """Prepares the views of an image placed by structure from motion.

        Yields none for an impossible camera, as the process that computed it is not trusted.

        Args:
            pose: [4, 4], world_from_camera.
            camera: COLMAP's model, width, height and parameters.
        """
        model, width, height, params = camera
        camera_model = CameraModel(model, width, height, tuple(params))
        try:
            check_camera_model(camera_model, field=image.name)
            lens = lens_of(camera_model, self.settings.max_side, field=image.name)
        except InvalidInputError:
            self.log.left_out[image.name] = "lens"
            return
        self.log.add(lens, image.quality, matches, image)
        opaque = None
        if image.photo is not None and image.face is None:
            opaque = self.decoder.opaque(self.files, image.photo, (image.width, image.height))
        source = SourceImage(
            name=image.name,
            pixels=source_pixels(image, self.images, self.decoder),
            undistortion=lens.faces[0].undistortion,
            world_from_camera=pose,
            lossless=image.name.lower().endswith(".png") and image.photo is not None and image.face is None,
            label_ids=self._ids(image.photo, lambda name: source_ids(image, self.files, name, self.decoder)),
            mask=both_masks(both_masks(image.mask, opaque), self.held.usable(image.file)),
            exposure_ev=None if image.photo is None else image.photo.exposure_ev,
            taken_at=None if image.photo is None else image.photo.taken_at,
        )
        self.held.split(image.name, [face_name(image.name, face.name) for face in lens.faces])
        yield from views_of(source, lens)

    def posed(self, image: PosedImage, photo: PhotoInfo) -> Iterator[SourceImage]:
        """Prepares the views of an uploaded pose; none if photo, mask or camera is unusable."""
        try:
            lens, geometries = posed_lens(image, photo, self.settings)
        except InvalidInputError:
            self.log.left_out[image.name] = "lens"
            return
        size = geometries[0].size
        try:
            decoded = self.decoder.photo(self.files, photo, size)
            mask = None if image.mask is None else self.decoder.ids(self.files, image.mask, photo, size) > 0
            mask = both_masks(mask, self.decoder.opaque(self.files, photo, size))
        except _BROKEN:
            self.log.left_out[image.name] = "unreadable"
            return
        photo_in_use = self.held.take(image.name, decoded)
        self.held.split(image.name, [face_name(image.name, face.name) for face in lens.faces])
        pixels, mask = photo_in_use.pixels, both_masks(photo_in_use.usable, mask)
        self.log.add(lens, measure_photo(image.name, pixels))
        depth = self._depth(image, photo)
        label_ids = self._ids(photo, lambda name: self.decoder.ids(self.files, name, photo, size))
        for face, geometry in zip(lens.faces, geometries, strict=True):
            unchanged = geometry.undistortion.map_xy is None and size == photo.upright_size
            yield SourceImage(
                name=face_name(image.name, face.name),
                pixels=pixels,
                undistortion=geometry.undistortion,
                world_from_camera=geometry.world_from_camera,
                lossless=photo.path.lower().endswith(".png") or unchanged,
                label_ids=label_ids,
                mask=mask,
                depth=depth,
                exposure_ev=photo.exposure_ev,
                taken_at=photo.taken_at,
            )

    def _depth(self, image: PosedImage, photo: PhotoInfo) -> tuple[F32, Camera] | None:
        size = self.manifest.depth_sizes.get(photo.path)
        if image.depth is None or size is None or self.manifest.splat:
            return None
        if is_fisheye(image.camera_model):
            self.log.unused_depths += 1
            return None
        try:
            return view_depth(image, image.depth, size, photo, self.decoder, self.files)
        except _BROKEN:
            self.log.broken_maps.append(image.depth.path)
            return None

    def _ids(self, photo: PhotoInfo | None, read: Callable[[str], NDArray[np.uint16]]) -> NDArray[np.uint16] | None:
        """Label ids of a photo's map, which `read` decodes by its name; None without a readable one."""
        stored = None if photo is None else self.manifest.label_maps.get(photo.path)
        if stored is None or self.table is None:
            return None
        try:
            return self.table.translate(read(stored))
        except _BROKEN:
            self.log.broken_maps.append(stored)
            return None


def view_depth(
    image: PosedImage,
    file: DepthFile,
    stored_size: tuple[int, int],
    photo: PhotoInfo,
    decoder: ImageDecoder,
    root: Path,
) -> tuple[F32, Camera]:
    """Undistorts a posed image's depth map, in scene units, and computes its camera.

    Args:
        image: its camera model is for the photo as stored.
        file: covers what the photo covers, in its stored orientation.
        stored_size: (width, height) of the map.

    Raises:
        CorruptImageError, LimitExceededError, ResourceError: as `ImageDecoder.photo`.
    """
    scale = min(1.0, MAX_SIDE / max(stored_size))
    width, height = (max(1, round(side * scale)) for side in stored_size)
    depth = decoder.depth(root, file, photo, (width, height))
    turns = photo.quarter_turns if image.camera_model.fits(photo.width, photo.height) else 0
    undistortion = compute_undistortion(image.camera_model.scaled_to(width, height), MAX_SIDE, field=image.name)
    undistortion = rotate90(undistortion, turns, width, height)
    depth = np.ascontiguousarray(np.rot90(depth, -turns))
    if undistortion.map_xy is not None:
        x, y = undistortion.map_xy[..., 0], undistortion.map_xy[..., 1]
        depth = np.asarray(cv2.remap(depth, x, y, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT))
    return depth, undistortion.camera
