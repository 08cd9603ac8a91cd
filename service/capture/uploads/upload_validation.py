"""Validates uploads completely before anything else uses them."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path, PurePosixPath

from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.captures import ValidatedUpload
from fastsplat.service.capture.formats.upload_manifest import FILES, VALIDATED, UploadManifest, write_manifest
from fastsplat.service.capture.photos.panorama import full_frame
from fastsplat.service.capture.photos.photo_metadata import read_metadata
from fastsplat.service.capture.photos.spherical_video import is_spherical
from fastsplat.service.capture.untrusted.archive import is_archive, unpack
from fastsplat.service.capture.untrusted.sandbox import run_sandboxed
from fastsplat.service.capture.uploads.label_maps import check_label_map, match_label_maps, read_label_table
from fastsplat.service.capture.uploads.left_out import LeftOut
from fastsplat.service.capture.uploads.photo_validation import (
    check_pixels,
    too_many_images,
    transparency_warning,
    usable_photos,
)
from fastsplat.service.capture.uploads.posed_validation import validate_posed
from fastsplat.service.capture.uploads.splat_files.splat_reading import is_splat_file
from fastsplat.service.capture.uploads.splat_input import admit_splat, check_splats
from fastsplat.service.capture.uploads.upload_kind import UploadContents, detect_kind
from fastsplat.service.common.file_names import common_folder, is_system_file
from fastsplat.service.common.files import atomic_directory, link_or_copy
from fastsplat_contract.errors import InvalidInputError, LimitExceededError

_MIN_IMAGES = 2
_VIDEO_SIGNATURES = (
    (4, b"ftyp"), (4, b"moov"), (4, b"mdat"), (4, b"wide"), (4, b"free"), (8, b"AVI "), (0, b"\x1aE\xdf\xa3"),
)  # fmt: skip


def validate_upload(upload_dir: Path, settings: CaptureSettings, strict: bool = False) -> ValidatedUpload:
    """Validates an upload and lays it out for `build_capture` in its folder `VALIDATED`.

    Accepts one archive, one video, or files: images alone, or with a COLMAP model, a transforms.json or label maps
    (`labels/*.png` with `labels.json`); a phone's recording; a splat, alone or with posed images. Unusable files are
    left out with reasons, or raise if `strict`. On an error, nothing is left behind.

    Raises:
        UnsafeArchiveError, LimitExceededError, CorruptImageError, InvalidInputError: see the readers; each names the
            file and gives advice.
    """
    with atomic_directory(upload_dir / VALIDATED) as partial:
        files = partial / FILES
        files.mkdir()
        _lay_out(upload_dir, files, settings)
        left_out = LeftOut(strict)
        contents = detect_kind(files, left_out)
        check_splats(contents.splats)
        if contents.source == "video":
            manifest = _validate_video(files, contents, settings)
        elif contents.source == "images":
            manifest = _validate_images(files, contents, _sent_bytes(upload_dir), settings, left_out)
        elif contents.source == "splat":
            manifest = UploadManifest("splat", warnings=contents.warnings)
        else:
            manifest = validate_posed(files, contents, _sent_bytes(upload_dir), settings, left_out)
        if contents.splats:
            manifest = admit_splat(files, contents, manifest, partial, settings)
        write_manifest(replace(manifest, left_out=left_out.reasons), partial)
    has_labels = bool(manifest.label_maps)
    target, photos = upload_dir / VALIDATED, len(manifest.photos)
    warnings, gaussians = manifest.warnings, manifest.gaussians
    return ValidatedUpload(target, manifest.source, photos, has_labels, warnings, gaussians, left_out.reasons)


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
            limit=f"{settings.max_entries} files",
            hint="Send fewer images.",
        )
    archives = [path for path in plain if not is_splat_file(path) and is_archive(path)]
    if archives and len(plain) > 1:
        raise InvalidInputError(
            f"the upload has {archives[0].name} and other files", field=archives[0].name, hint="Send one archive alone."
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
        raise InvalidInputError.of(contents.video, "is not a video", "Send an MP4, MOV, WebM, MKV or AVI file.")
    with tempfile.TemporaryDirectory() as folder:
        request = {"video": str(files / contents.video), "name": contents.video, **settings.model_dump()}
        size = run_sandboxed("probe", request, Path(folder), settings, lambda fraction, message: None)
    spherical = is_spherical(files / contents.video, contents.video)
    if spherical:
        full_frame(contents.video, size["width"], size["height"])
    return UploadManifest("video", video=contents.video, warnings=contents.warnings, spherical=spherical)


def _validate_images(
    files: Path, contents: UploadContents, sent_bytes: int, settings: CaptureSettings, left_out: LeftOut
) -> UploadManifest:
    if len(contents.images) + len(left_out.reasons) > 2 * settings.max_images:
        raise too_many_images(len(contents.images), settings)
    maps = contents.label_maps if contents.labels else ()
    check_pixels(files, [*contents.images, *maps], sent_bytes, settings)
    photos = usable_photos(files, contents.images, settings, left_out)
    label_maps: dict[str, str] = {}
    if contents.labels and photos:
        label_maps = match_label_maps(contents.label_maps, contents.images)
        table = read_label_table(files, contents.labels, settings) if label_maps else None
        for photo in photos:
            if table is not None and photo.path in label_maps:
                with left_out.costs(photo.path):
                    sizes = {photo.upright_size, (photo.width, photo.height)}
                    check_label_map(files, label_maps[photo.path], table, sizes, settings)
        photos = tuple(photo for photo in photos if photo.path not in left_out.reasons)
        label_maps = {photo.path: label_maps[photo.path] for photo in photos if photo.path in label_maps}
    elif contents.label_maps and photos:
        raise InvalidInputError(
            "the upload has label maps, but no labels.json",
            field="labels.json",
            hint='Send labels.json with the names of the ids, e.g. {"mug": 1}.',
        )
    if len(photos) < _MIN_IMAGES:
        name = contents.images[0]
        raise left_out.refusal(
            InvalidInputError(
                f"one image ({name}) without a pose is not enough for a scene",
                field=name,
                limit=f"at least {_MIN_IMAGES} images",
                hint="Send at least two overlapping photos, better twenty, or send poses with the image.",
            )
        )
    folder = PurePosixPath(common_folder(contents.images))
    return UploadManifest(
        source="images",
        photos=photos,
        names=tuple(PurePosixPath(photo.path).relative_to(folder).as_posix() for photo in photos),
        labels=contents.labels if label_maps else "",
        label_maps=label_maps,
        warnings=(*contents.warnings, *transparency_warning(photos)),
        metadata=read_metadata(files, photos),
    )


def _sent_bytes(upload_dir: Path) -> int:
    """Sums up the bytes of an upload as sent."""
    entries = (path for path in upload_dir.iterdir() if path.name != VALIDATED and not path.name.startswith("."))
    paths = (path for top in entries for path in (top, *top.rglob("*")))
    return sum(path.stat().st_size for path in paths if path.is_file())
