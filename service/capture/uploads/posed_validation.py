"""Validates uploads with poses; unusable frames are left out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path, PurePosixPath

from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.formats.depth_files import IMAGE_SUFFIXES, depth_size, read_depth
from fastsplat.service.capture.formats.image_io import PhotoInfo, open_map, read_size
from fastsplat.service.capture.formats.upload_manifest import UploadManifest
from fastsplat.service.capture.photos.camera_model import aspect_error
from fastsplat.service.capture.uploads.colmap_model import read_colmap
from fastsplat.service.capture.uploads.label_maps import check_label_map, match_label_maps, read_label_table
from fastsplat.service.capture.uploads.left_out import LeftOut
from fastsplat.service.capture.uploads.phones.polycam import read_polycam
from fastsplat.service.capture.uploads.phones.record3d import read_record3d
from fastsplat.service.capture.uploads.phones.scanner_app import read_scanner_app
from fastsplat.service.capture.uploads.photo_validation import check_pixels, transparency_warning, usable_photos
from fastsplat.service.capture.uploads.posed_input import PosedDataset, PosedImage
from fastsplat.service.capture.uploads.transforms import read_transforms
from fastsplat.service.capture.uploads.upload_kind import UploadContents
from fastsplat.service.common.file_names import list_names
from fastsplat_contract.errors import InvalidInputError, LimitExceededError

_LEAST_KNOWN = 0.01
_PHONES = {"polycam": read_polycam, "record3d": read_record3d, "arkit": read_scanner_app}


def read_posed_dataset(
    files: Path,
    upload: UploadManifest | UploadContents,
    sizes: Mapping[str, tuple[int, int]],
    settings: CaptureSettings,
    left_out: LeftOut | None = None,
) -> PosedDataset:
    """Reads an upload's posed images; errors as the readers.

    Args:
        sizes: (width, height) of its images as stored.
        left_out: receives unusable frames; None: they raise errors.
    """
    left_out = left_out or LeftOut(strict=True)
    if upload.source == "colmap":
        return read_colmap(files, upload.poses, upload.image_folder, settings, left_out)
    if upload.source in _PHONES:
        return _PHONES[upload.source](files, upload.poses, sizes, settings, left_out)
    return read_transforms(files, upload.poses, sizes, settings, left_out)


def read_validated_dataset(files: Path, manifest: UploadManifest, settings: CaptureSettings) -> PosedDataset:
    """Reads the posed images in the manifest of a validated upload."""
    sizes = {photo.path: (photo.width, photo.height) for photo in manifest.photos}
    any_share = settings.model_copy(update={"min_frames_present": 0.0})  # left-out images count as missing by now
    dataset = read_posed_dataset(files, manifest, sizes, any_share, LeftOut())
    return replace(dataset, images=tuple(image for image in dataset.images if image.path in sizes))


class ImageSizes(Mapping[str, tuple[int, int]]):
    """(width, height) of images as stored, read from headers on lookup."""

    def __init__(self, files: Path, paths: tuple[str, ...], settings: CaptureSettings) -> None:
        self._files, self._paths, self._settings = files, frozenset(paths), settings

    def __getitem__(self, path: str) -> tuple[int, int]:
        if path not in self._paths:
            raise KeyError(path)
        return read_size(self._files, path, self._settings)

    def __contains__(self, path: object) -> bool:
        return path in self._paths

    def __iter__(self) -> Iterator[str]:
        return iter(self._paths)

    def __len__(self) -> int:
        return len(self._paths)


def validate_posed(
    files: Path, contents: UploadContents, sent_bytes: int, settings: CaptureSettings, left_out: LeftOut
) -> UploadManifest:
    """Makes the manifest of an upload with poses; an unusable file costs its frame.

    Raises:
        InvalidInputError, LimitExceededError, CorruptImageError: the document cannot be read, no frame is left, or the
            images are too many or have too many pixels.
    """
    dataset = read_posed_dataset(files, contents, ImageSizes(files, contents.images, settings), settings, left_out)
    paths = tuple(sorted({image.path for image in dataset.images}))
    maps = {name for image in dataset.images for name in (image.mask, image.label_map) if name is not None}
    maps |= set(contents.label_maps if contents.labels else ())
    check_pixels(files, [*paths, *sorted(maps)], sent_bytes, settings)
    check_pixels(files, depth_images(dataset), sent_bytes, settings)
    depth_sizes, depth_warnings = check_depths(files, dataset, settings, left_out)
    photo_by_path = {photo.path: photo for photo in usable_photos(files, paths, settings, left_out)}
    label_maps = {image.path: image.label_map for image in dataset.images if image.label_map is not None}
    table = dataset.labels
    labels = ""
    if table is None and contents.labels:
        gone = [image.path for image in dataset.missing]
        gone += [path for path in contents.images if path in left_out.reasons and path not in paths]
        label_maps = match_label_maps(contents.label_maps, paths, gone)
        if label_maps:
            labels, table = contents.labels, read_label_table(files, contents.labels, settings)
    images, blank_masks = [], 0
    for image in dataset.images:
        photo = photo_by_path.get(image.path)
        if photo is None or image.path in left_out.reasons:
            continue
        with left_out.costs(image.path):
            _check_posed_image(image, photo)
            blank = image.mask is not None and not _check_mask(files, image.mask, photo, settings)
            if table is not None and image.path in label_maps:
                sizes = {photo.upright_size, (photo.width, photo.height)}
                check_label_map(files, label_maps[image.path], table, sizes, settings)
            images.append(image)
            blank_masks += blank
    if not images:
        raise left_out.refusal(
            InvalidInputError(f"{contents.poses} has no frame", field=contents.poses, hint="Export it again.")
        )
    if blank_masks == len(images):
        raise InvalidInputError(
            "the masks of all images are 0 everywhere, which leaves no pixel to use",
            field=contents.poses,
            hint="In a mask, 0 is what to ignore; invert the masks, or leave them out.",
        )
    used = {image.path for image in images}
    photos = tuple(photo_by_path[image.path] for image in images)
    return UploadManifest(
        source=contents.source,
        photos=photos,
        names=tuple(image.name for image in images),
        poses=contents.poses,
        image_folder=contents.image_folder,
        labels=labels,
        label_maps={path: name for path, name in label_maps.items() if path in used},
        warnings=(*contents.warnings, *dataset.warnings, *depth_warnings, *transparency_warning(photos)),
        depth_sizes={path: size for path, size in depth_sizes.items() if path in used},
    )


def _check_posed_image(image: PosedImage, photo: PhotoInfo) -> None:
    fits_stored = image.camera_model.fits(photo.width, photo.height)
    if not fits_stored and not image.camera_model.fits(*photo.upright_size):
        raise aspect_error(image.path, image.camera_model, photo.width, photo.height)
    if photo.mirrored and fits_stored:
        raise InvalidInputError.of(
            image.path,
            "is stored mirrored, which no camera pose can undo",
            "Apply the orientation to the pixels before computing poses.",
        )


def _check_mask(files: Path, name: str, photo: PhotoInfo, settings: CaptureSettings) -> bool:
    """Checks for a usable pixel. Raises `InvalidInputError` on a wrong size."""
    mask = open_map(files, name, settings)
    height, width = mask.shape
    if (width, height) not in (photo.upright_size, (photo.width, photo.height)):
        raise InvalidInputError.of(
            name,
            f"has {width}×{height} pixels, its image has {photo.upright_size[0]}×{photo.upright_size[1]}",
            "Send masks of exactly their image's size.",
        )
    return bool(mask.any())


def depth_images(dataset: PosedDataset) -> tuple[str, ...]:
    """Lists depth and confidence maps that are images, sorted."""
    depths = [image.depth for image in dataset.images if image.depth is not None]
    names = {name for depth in depths for name in (depth.path, depth.confidence) if name is not None}
    return tuple(sorted(name for name in names if PurePosixPath(name).suffix.lower() in IMAGE_SUFFIXES))


def check_depths(
    files: Path, dataset: PosedDataset, settings: CaptureSettings, left_out: LeftOut
) -> tuple[dict[str, tuple[int, int]], tuple[str, ...]]:
    """Checks depth maps; returns sizes by photo path, and warnings for people.

    A map with less than 1 % known pixels is ignored; one that is damaged, too large or of another aspect ratio costs
    its frame. Raises `LimitExceededError` beyond `max_pixels` in all.
    """
    sizes: dict[str, tuple[int, int]] = {}
    pixels, empty = 0, []
    for image in dataset.images:
        if image.depth is None:
            continue
        with left_out.costs(image.path):
            width, height = depth_size(files, image.depth, settings)
            if not image.camera_model.fits(width, height):
                raise aspect_error(image.depth.path, image.camera_model, width, height)
            pixels += width * height
            if pixels > settings.max_pixels:
                break
            known = read_depth(files, image.depth, settings) > 0
            if known.mean() < _LEAST_KNOWN:
                empty.append(image.name)
            else:
                sizes[image.path] = (width, height)
    if pixels > settings.max_pixels:
        raise LimitExceededError(
            "the depth maps of the upload have too many pixels together",
            field="files",
            limit=f"{settings.max_pixels} pixels",
            hint="Send fewer or smaller depth maps.",
        )
    if not empty:
        return sizes, ()
    warning = f"{len(empty)} depth maps have hardly a known pixel and are not used: {list_names(empty)}."
    return sizes, (warning,)
