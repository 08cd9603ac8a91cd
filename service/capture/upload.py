"""The border: an upload is unpacked, classified and checked to its last row before anything else touches it."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path, PurePosixPath

from fastsplat.service.capture.archive import is_archive, unpack
from fastsplat.service.capture.colmap_model import read_colmap
from fastsplat.service.capture.contents import Contents, classify, common_folder
from fastsplat.service.capture.documents import read_json
from fastsplat.service.capture.folders import appearing
from fastsplat.service.capture.given import GivenPoses, fits, wrong_aspect
from fastsplat.service.capture.images import PhotoInfo, check_image, open_map, read_header
from fastsplat.service.capture.isolation import run_isolated
from fastsplat.service.capture.labels import LabelTable, check_label_map, label_table
from fastsplat.service.capture.manifest import ADMITTED, FILES, Manifest, write_manifest
from fastsplat.service.capture.names import is_litter
from fastsplat.service.capture.settings import CaptureSettings
from fastsplat.service.capture.transforms import read_transforms
from fastsplat.service.capture.types import AdmittedUpload
from fastsplat_contract.errors import InvalidInputError, LimitExceededError

_MIN_IMAGES = 2
_VIDEO_HEADS = (
    (4, b"ftyp"),
    (4, b"moov"),
    (4, b"mdat"),
    (4, b"wide"),
    (4, b"free"),
    (8, b"AVI "),
    (0, b"\x1aE\xdf\xa3"),
)


def admit_upload(upload_dir: Path, settings: CaptureSettings) -> AdmittedUpload:
    """Check what a user sent and lay it out for `build_capture`, inside `upload_dir` as `.admitted`.

    Accepts one archive (zip, tar, tar.gz), one video, or files: images alone, or with a COLMAP model, a transforms.json
    or label maps (`labels/*.png` with `labels.json`). Every image is decoded once. On an error nothing is left behind
    but what was there.

    Raises:
        UnsafeArchiveError, LimitExceededError, CorruptImageError, InvalidInputError: see the readers; each names the
            file and says what to do.
    """
    with appearing(upload_dir / ADMITTED) as partial:
        files = partial / FILES
        files.mkdir()
        _lay_out(upload_dir, files, settings)
        contents = classify(files)
        if contents.source == "video":
            manifest = _admit_video(files, contents, settings)
        elif contents.source == "images":
            manifest = _admit_images(files, contents, settings)
        else:
            manifest = _admit_posed(files, contents, settings)
        write_manifest(manifest, partial)
    has_labels = bool(manifest.label_maps)
    return AdmittedUpload(upload_dir / ADMITTED, manifest.source, len(manifest.photos), has_labels, manifest.warnings)


def read_poses(
    files: Path,
    manifest_or_contents: Manifest | Contents,
    sizes: Mapping[str, tuple[int, int]],
    settings: CaptureSettings,
) -> GivenPoses:
    """Poses of an upload that has some; `sizes` are those of its images as stored."""
    poses = manifest_or_contents.poses
    if manifest_or_contents.source == "colmap":
        return read_colmap(files, poses, manifest_or_contents.image_folder, settings)
    return read_transforms(files, poses, sizes, settings)


def read_labels(files: Path, labels: str, settings: CaptureSettings) -> LabelTable:
    """The table of a labels.json."""
    return label_table(read_json(files / labels, labels, settings), field=labels)


def _lay_out(upload_dir: Path, files: Path, settings: CaptureSettings) -> None:
    sent = [path for path in sorted(upload_dir.rglob("*")) if not is_litter(path.relative_to(upload_dir).parts)]
    plain = [path for path in sent if path.is_file() and not path.is_symlink()]
    special = [path for path in sent if path.is_symlink() or not (path.is_file() or path.is_dir())]
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
    archives = [path for path in plain if is_archive(path)]
    if archives and len(plain) > 1:
        raise InvalidInputError(
            f"the upload holds {archives[0].name} and other files",
            field=archives[0].name,
            hint="Send one archive alone.",
        )
    if archives:
        unpack(archives[0], files, settings)
        return
    for path in plain:
        target = files / path.relative_to(upload_dir)
        target.parent.mkdir(parents=True, exist_ok=True)
        try:
            os.link(path, target)
        except OSError:  # a file system without hard links
            shutil.copyfile(path, target)


def _admit_video(files: Path, contents: Contents, settings: CaptureSettings) -> Manifest:
    with (files / contents.video).open("rb") as file:
        head = file.read(16)
    # Decoders guess by content and would follow a playlist called .mp4 to other files and hosts.
    if not any(head[at:].startswith(mark) for at, mark in _VIDEO_HEADS):
        raise InvalidInputError(
            f"{contents.video} is no video", field=contents.video, hint="Send an MP4, MOV, WebM, MKV or AVI file."
        )
    with tempfile.TemporaryDirectory() as folder:
        request = {"video": str(files / contents.video), "name": contents.video, **settings.model_dump()}
        run_isolated("probe", request, Path(folder), settings, lambda fraction, message: None)
    return Manifest("video", video=contents.video, warnings=contents.warnings)


def _admit_images(files: Path, contents: Contents, settings: CaptureSettings) -> Manifest:
    if len(contents.images) < _MIN_IMAGES:
        raise InvalidInputError(
            f"one image ({contents.images[0]}) without a pose is no scene",
            field=contents.images[0],
            limit=f"at least {_MIN_IMAGES} images",
            hint="Send at least two overlapping photos, better twenty, or send poses with the image.",
        )
    photos = _check_images(files, contents.images, settings)
    label_maps = match_labels(contents, [photo.path for photo in photos])
    if label_maps:
        _check_maps(files, photos, label_maps, read_labels(files, contents.labels, settings), settings)
    folder = common_folder(photo.path for photo in photos)
    return Manifest(
        source="images",
        photos=photos,
        names=tuple(_relative(photo.path, folder) for photo in photos),
        labels=contents.labels if label_maps else "",
        label_maps=label_maps,
        warnings=contents.warnings,
    )


def _admit_posed(files: Path, contents: Contents, settings: CaptureSettings) -> Manifest:
    poses = read_poses(files, contents, ImageSizes(files, contents.images, settings), settings)
    paths = tuple(sorted({photo.path for photo in poses.photos}))
    checked = {photo.path: photo for photo in _check_images(files, paths, settings)}
    for given in poses.photos:
        photo = checked[given.path]
        upright, stored = photo.upright_size, (photo.width, photo.height)
        if not fits(given.lens, *upright) and not fits(given.lens, *stored):
            raise wrong_aspect(given.path, given.lens, *stored)
        if photo.mirrored and fits(given.lens, *stored):
            raise _mirrored(given.path)
        if given.mask is not None:
            height, width = open_map(files, given.mask, settings).shape
            if (width, height) not in (upright, stored):
                raise InvalidInputError(
                    f"{given.mask} has {width}×{height} pixels, its image has {upright[0]}×{upright[1]}",
                    field=given.mask,
                    hint="Send masks of exactly their image's size.",
                )
    label_maps = {photo.path: photo.label_map for photo in poses.photos if photo.label_map is not None}
    table = poses.labels
    labels = ""
    if table is None:
        label_maps = match_labels(contents, [photo.path for photo in poses.photos])
        if label_maps:
            labels, table = contents.labels, read_labels(files, contents.labels, settings)
    ordered = tuple(checked[photo.path] for photo in poses.photos)
    if table is not None:
        _check_maps(files, ordered, label_maps, table, settings)
    return Manifest(
        source=contents.source,
        photos=ordered,
        names=tuple(photo.name for photo in poses.photos),
        poses=contents.poses,
        image_folder=contents.image_folder,
        labels=labels,
        label_maps=label_maps,
        warnings=(*contents.warnings, *poses.warnings),
    )


class ImageSizes(Mapping[str, tuple[int, int]]):
    """(width, height) of images as stored, read from their headers when asked for."""

    def __init__(self, files: Path, paths: tuple[str, ...], settings: CaptureSettings) -> None:
        self._files, self._paths, self._settings = files, frozenset(paths), settings

    def __getitem__(self, path: str) -> tuple[int, int]:
        if path not in self._paths:
            raise KeyError(path)
        photo = read_header(self._files, path, self._settings)
        return photo.width, photo.height

    def __contains__(self, path: object) -> bool:
        return path in self._paths

    def __iter__(self) -> Iterator[str]:
        return iter(self._paths)

    def __len__(self) -> int:
        return len(self._paths)


def _check_images(files: Path, paths: tuple[str, ...], settings: CaptureSettings) -> tuple[PhotoInfo, ...]:
    if len(paths) > settings.max_images:
        raise LimitExceededError(
            f"the upload has {len(paths)} images",
            field="files",
            limit=f"{settings.max_images} images (FASTSPLAT_CAPTURE__MAX_IMAGES)",
            hint="Send fewer images.",
        )
    with ThreadPoolExecutor(max_workers=min(4, os.cpu_count() or 1)) as pool:
        jobs = [pool.submit(check_image, files, path, settings) for path in paths]
        try:
            return tuple(job.result() for job in jobs)
        finally:
            pool.shutdown(cancel_futures=True)


def _check_maps(
    files: Path, photos: tuple[PhotoInfo, ...], label_maps: dict[str, str], table: LabelTable, settings: CaptureSettings
) -> None:
    for photo in photos:
        if photo.path in label_maps:
            sizes = {photo.upright_size, (photo.width, photo.height)}
            check_label_map(files, label_maps[photo.path], table, sizes, settings)


def match_labels(contents: Contents, photos: list[str]) -> dict[str, str]:
    """Photo to label map: the file of the same name below labels/, folders below it included, or of the same stem."""
    if not contents.labels:
        if contents.label_maps and contents.source == "images":
            raise InvalidInputError(
                "the upload has label maps, but no labels.json",
                field="labels.json",
                hint='Send labels.json with the names of the ids, e.g. {"mug": 1}.',
            )
        return {}
    folder = common_folder(photos)
    by_key = {}
    for path in photos:
        by_key[PurePosixPath(_relative(path, folder)).with_suffix("").as_posix()] = path
    found = {}
    for label_map in contents.label_maps:
        parts = PurePosixPath(label_map).with_suffix("").parts
        key = "/".join(parts[parts.index("labels") + 1 :])
        if key not in by_key:
            raise InvalidInputError(
                f"{label_map} belongs to no image", field=label_map, hint="Name each label map like its image."
            )
        found[by_key[key]] = label_map
    return found


def _relative(path: str, folder: str) -> str:
    return path if folder == "." else PurePosixPath(path).relative_to(folder).as_posix()


def _mirrored(path: str) -> InvalidInputError:
    return InvalidInputError(
        f"{path} is stored mirrored, which no camera pose can undo",
        field=path,
        hint="Apply the orientation to the pixels before finding poses.",
    )
