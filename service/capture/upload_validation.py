"""Validates uploads: unpacked, their kind detected, and checked to the last row before anything else uses them."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path, PurePosixPath

from fastsplat.service.capture.archive import is_archive, unpack
from fastsplat.service.capture.camera_model import aspect_error
from fastsplat.service.capture.colmap_model import read_colmap
from fastsplat.service.capture.depth_validation import check_depths, depth_images
from fastsplat.service.capture.image_io import PhotoInfo, check_image, open_map, read_size
from fastsplat.service.capture.label_maps import LabelTable, check_label_map, match_label_maps, read_label_table
from fastsplat.service.capture.panorama import full_frame
from fastsplat.service.capture.phones.polycam import read_polycam
from fastsplat.service.capture.phones.record3d import read_record3d
from fastsplat.service.capture.phones.scanner_app import read_scanner_app
from fastsplat.service.capture.photo_metadata import read_metadata
from fastsplat.service.capture.posed_input import PosedDataset, PosedImage
from fastsplat.service.capture.sandbox import run_sandboxed
from fastsplat.service.capture.settings import CaptureSettings
from fastsplat.service.capture.spherical_video import is_spherical
from fastsplat.service.capture.splat_files.splat_reading import SPZ_SUFFIX
from fastsplat.service.capture.splat_input import admit_splat, check_splats
from fastsplat.service.capture.transforms import read_transforms
from fastsplat.service.capture.types import ValidatedUpload
from fastsplat.service.capture.upload_kind import UploadContents, detect_kind
from fastsplat.service.capture.upload_manifest import FILES, VALIDATED, UploadManifest, write_manifest
from fastsplat.service.common.atomic import atomic_directory, link_or_copy
from fastsplat.service.common.file_names import common_folder, is_system_file
from fastsplat_contract.errors import InvalidInputError, LimitExceededError

_MIN_IMAGES = 2
_PHONES = {"polycam": read_polycam, "record3d": read_record3d, "arkit": read_scanner_app}
_FREE_PIXELS = 256_000_000
_VIDEO_SIGNATURES = (
    (4, b"ftyp"),
    (4, b"moov"),
    (4, b"mdat"),
    (4, b"wide"),
    (4, b"free"),
    (8, b"AVI "),
    (0, b"\x1aE\xdf\xa3"),
)


def validate_upload(upload_dir: Path, settings: CaptureSettings) -> ValidatedUpload:
    """The checked content of what a user sent, laid out for `build_capture` in `upload_dir`'s folder `VALIDATED`.

    Accepts one archive (zip, tar, tar.gz), one video, or files: images alone, or with a COLMAP model, a transforms.json
    or label maps (`labels/*.png` with `labels.json`); a splat, alone or with posed images. Every image is decoded once,
    a splat is read once and laid down as plain arrays. On an error nothing is left behind but what was there.

    Raises:
        UnsafeArchiveError, LimitExceededError, CorruptImageError, InvalidInputError: see the readers; each names the
            file and says what to do.
    """
    with atomic_directory(upload_dir / VALIDATED) as partial:
        files = partial / FILES
        files.mkdir()
        _lay_out(upload_dir, files, settings)
        contents = detect_kind(files)
        check_splats(contents.splats)
        if contents.source == "video":
            manifest = _validate_video(files, contents, settings)
        elif contents.source == "images":
            manifest = _validate_images(files, contents, _sent_bytes(upload_dir), settings)
        elif contents.source == "splat":
            manifest = UploadManifest("splat", warnings=contents.warnings)
        else:
            manifest = _validate_posed(files, contents, _sent_bytes(upload_dir), settings)
        if contents.splats:
            manifest = admit_splat(files, contents, manifest, partial, settings)
        write_manifest(manifest, partial)
    has_labels = bool(manifest.label_maps)
    return ValidatedUpload(
        upload_dir / VALIDATED,
        manifest.source,
        len(manifest.photos),
        has_labels,
        manifest.warnings,
        manifest.gaussians,
    )


def read_posed_dataset(
    files: Path,
    upload: UploadManifest | UploadContents,
    sizes: Mapping[str, tuple[int, int]],
    settings: CaptureSettings,
) -> PosedDataset:
    """Images with cameras and poses of an upload that has some; `sizes` are those of its images as stored."""
    if upload.source == "colmap":
        return read_colmap(files, upload.poses, upload.image_folder, settings)
    if upload.source in _PHONES:
        return _PHONES[upload.source](files, upload.poses, sizes, settings)
    return read_transforms(files, upload.poses, sizes, settings)


class ImageSizes(Mapping[str, tuple[int, int]]):
    """(width, height) of images as stored, read from their headers when looked up."""

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


def _lay_out(upload_dir: Path, files: Path, settings: CaptureSettings) -> None:
    paths = [path for path in sorted(upload_dir.rglob("*")) if not is_system_file(path.relative_to(upload_dir).parts)]
    plain = [path for path in paths if path.is_file() and not path.is_symlink()]
    special = [path for path in paths if path.is_symlink() or not (path.is_file() or path.is_dir())]
    if special:
        name = special[0].relative_to(upload_dir).as_posix()
        raise InvalidInputError(f"{name} is a link or a special file", field=name, hint="Send plain files.")
    if len(plain) > settings.max_entries:
        raise LimitExceededError(
            f"the upload has {len(plain)} files",
            field="files",
            limit=f"{settings.max_entries} files (FASTSPLAT_CAPTURE__MAX_ENTRIES)",
            hint="Send fewer images.",
        )
    archives = [path for path in plain if path.suffix.lower() != SPZ_SUFFIX and is_archive(path)]
    if archives and len(plain) > 1:
        raise InvalidInputError(
            f"the upload has {archives[0].name} and other files",
            field=archives[0].name,
            hint="Send one archive alone.",
        )
    if archives:
        unpack(archives[0], files, settings)
        return
    for path in plain:
        target = files / path.relative_to(upload_dir)
        target.parent.mkdir(parents=True, exist_ok=True)
        link_or_copy(path, target)


def _validate_video(files: Path, contents: UploadContents, settings: CaptureSettings) -> UploadManifest:
    with (files / contents.video).open("rb") as file:
        head = file.read(16)
    # Decoders guess by content and would follow a playlist called .mp4 to other files and hosts.
    if not any(head[at:].startswith(signature) for at, signature in _VIDEO_SIGNATURES):
        raise InvalidInputError(
            f"{contents.video} is not a video", field=contents.video, hint="Send an MP4, MOV, WebM, MKV or AVI file."
        )
    with tempfile.TemporaryDirectory() as folder:
        request = {"video": str(files / contents.video), "name": contents.video, **settings.model_dump()}
        size = run_sandboxed("probe", request, Path(folder), settings, lambda fraction, message: None)
    spherical = is_spherical(files / contents.video, contents.video)
    if spherical:
        full_frame(contents.video, size["width"], size["height"])
    return UploadManifest("video", video=contents.video, warnings=contents.warnings, spherical=spherical)


def _validate_images(
    files: Path, contents: UploadContents, sent_bytes: int, settings: CaptureSettings
) -> UploadManifest:
    maps = contents.label_maps if contents.labels else ()
    _check_pixels(files, [*contents.images, *maps], sent_bytes, settings)
    photos = _check_images(files, contents.images, settings)
    if len(photos) < _MIN_IMAGES:
        raise InvalidInputError(
            f"one image ({photos[0].path}) without a pose is not enough for a scene",
            field=photos[0].path,
            limit=f"at least {_MIN_IMAGES} images",
            hint="Send at least two overlapping photos, better twenty, or send poses with the image.",
        )
    label_maps: dict[str, str] = {}
    if contents.labels:
        label_maps = match_label_maps(contents.label_maps, contents.images)
        if label_maps:
            table = read_label_table(files, contents.labels, settings)
            _check_label_maps(files, photos, label_maps, table, settings)
    elif contents.label_maps:
        raise InvalidInputError(
            "the upload has label maps, but no labels.json",
            field="labels.json",
            hint='Send labels.json with the names of the ids, e.g. {"mug": 1}.',
        )
    folder = PurePosixPath(common_folder(contents.images))
    return UploadManifest(
        source="images",
        photos=photos,
        names=tuple(PurePosixPath(photo.path).relative_to(folder).as_posix() for photo in photos),
        labels=contents.labels if label_maps else "",
        label_maps=label_maps,
        warnings=contents.warnings,
        metadata=read_metadata(files, photos),
    )


def _validate_posed(
    files: Path, contents: UploadContents, sent_bytes: int, settings: CaptureSettings
) -> UploadManifest:
    dataset = read_posed_dataset(files, contents, ImageSizes(files, contents.images, settings), settings)
    paths = tuple(sorted({image.path for image in dataset.images}))
    maps = {name for image in dataset.images for name in (image.mask, image.label_map) if name is not None}
    maps |= set(contents.label_maps if contents.labels else ())
    _check_pixels(files, [*paths, *sorted(maps)], sent_bytes, settings)
    _check_pixels(files, depth_images(dataset), sent_bytes, settings)
    depth_sizes, depth_warnings = check_depths(files, dataset, settings)
    photo_by_path = {photo.path: photo for photo in _check_images(files, paths, settings)}
    blank_masks = 0
    for image in dataset.images:
        _check_posed_image(image, photo_by_path[image.path])
        if image.mask is not None:
            blank_masks += not _check_mask(files, image.mask, photo_by_path[image.path], settings)
    if blank_masks == len(dataset.images):
        raise InvalidInputError(
            "the masks of all images are 0 everywhere, which leaves no pixel to use",
            field=contents.poses,
            hint="In a mask, 0 is what to ignore; invert the masks, or leave them out.",
        )
    label_maps = {image.path: image.label_map for image in dataset.images if image.label_map is not None}
    table = dataset.labels
    labels = ""
    if table is None and contents.labels:
        missing = [image.path for image in dataset.missing]
        label_maps = match_label_maps(contents.label_maps, [image.path for image in dataset.images], missing)
        if label_maps:
            labels, table = contents.labels, read_label_table(files, contents.labels, settings)
    photos = tuple(photo_by_path[image.path] for image in dataset.images)
    if table is not None:
        _check_label_maps(files, photos, label_maps, table, settings)
    return UploadManifest(
        source=contents.source,
        photos=photos,
        names=tuple(image.name for image in dataset.images),
        poses=contents.poses,
        image_folder=contents.image_folder,
        labels=labels,
        label_maps=label_maps,
        warnings=(*contents.warnings, *dataset.warnings, *depth_warnings),
        depth_sizes=depth_sizes,
    )


def _check_posed_image(image: PosedImage, photo: PhotoInfo) -> None:
    fits_stored = image.camera_model.fits(photo.width, photo.height)
    if not fits_stored and not image.camera_model.fits(*photo.upright_size):
        raise aspect_error(image.path, image.camera_model, photo.width, photo.height)
    if photo.mirrored and fits_stored:
        raise InvalidInputError(
            f"{image.path} is stored mirrored, which no camera pose can undo",
            field=image.path,
            hint="Apply the orientation to the pixels before computing poses.",
        )


def _check_mask(files: Path, name: str, photo: PhotoInfo, settings: CaptureSettings) -> bool:
    """Whether any pixel of the mask counts. Raises `InvalidInputError` if it does not have its image's size."""
    mask = open_map(files, name, settings)
    height, width = mask.shape
    if (width, height) not in (photo.upright_size, (photo.width, photo.height)):
        raise InvalidInputError(
            f"{name} has {width}×{height} pixels, its image has {photo.upright_size[0]}×{photo.upright_size[1]}",
            field=name,
            hint="Send masks of exactly their image's size.",
        )
    return bool(mask.any())


def _sent_bytes(upload_dir: Path) -> int:
    """Bytes of an upload as it was sent."""
    own = (path for path in upload_dir.iterdir() if path.name != VALIDATED and not path.name.startswith("."))
    paths = (path for top in own for path in (top, *top.rglob("*")))
    return sum(path.stat().st_size for path in paths if path.is_file())


def _check_pixels(files: Path, names: Sequence[str], sent_bytes: int, settings: CaptureSettings) -> None:
    """Refuse images by their headers, before any is decoded: a few bytes may claim many pixels.

    Raises:
        LimitExceededError: more than `max_images`, or more pixels than `max_pixels` or than their bytes allow.
        CorruptImageError: one is no image.
    """
    if len(names) > 2 * settings.max_images:
        raise _too_many_images(len(names), settings)
    pixels, ratio = 0, settings.max_pixels_per_byte
    for name in names:
        width, height = read_size(files, name, settings)
        pixels += width * height
        if pixels > settings.max_pixels:
            raise LimitExceededError(
                "the images of the upload have too many pixels together",
                field=name,
                limit=f"{settings.max_pixels} pixels (FASTSPLAT_CAPTURE__MAX_PIXELS)",
                hint="Send fewer or smaller images.",
            )
        if pixels > max(_FREE_PIXELS, ratio * sent_bytes):
            raise LimitExceededError(
                f"the images have more than {ratio} pixels a byte of the upload, as decompression bombs do",
                field=name,
                limit=f"{ratio} pixels a byte (FASTSPLAT_CAPTURE__MAX_PIXELS_PER_BYTE)",
                hint="Send fewer or smaller images.",
            )


def _too_many_images(count: int, settings: CaptureSettings) -> LimitExceededError:
    return LimitExceededError(
        f"the upload has {count} images",
        field="files",
        limit=f"{settings.max_images} images (FASTSPLAT_CAPTURE__MAX_IMAGES)",
        hint="Send fewer images.",
    )


def _check_images(files: Path, paths: tuple[str, ...], settings: CaptureSettings) -> tuple[PhotoInfo, ...]:
    if len(paths) > settings.max_images:
        raise _too_many_images(len(paths), settings)
    with ThreadPoolExecutor(max_workers=min(4, os.cpu_count() or 1)) as pool:
        jobs = [pool.submit(check_image, files, path, settings) for path in paths]
        try:
            return tuple(job.result() for job in jobs)
        finally:
            pool.shutdown(cancel_futures=True)


def _check_label_maps(
    files: Path, photos: tuple[PhotoInfo, ...], label_maps: dict[str, str], table: LabelTable, settings: CaptureSettings
) -> None:
    for photo in photos:
        if photo.path in label_maps:
            sizes = {photo.upright_size, (photo.width, photo.height)}
            check_label_map(files, label_maps[photo.path], table, sizes, settings)
