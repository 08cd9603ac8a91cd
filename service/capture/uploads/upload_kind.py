"""Detects an upload's kind: images, video, COLMAP model, transforms.json, recording or splat."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

from fastsplat.service.capture.captures import Source
from fastsplat.service.capture.formats.image_io import IMAGE_SUFFIXES, UNSUPPORTED_SUFFIXES
from fastsplat.service.capture.untrusted.archive import ARCHIVE_SUFFIXES
from fastsplat.service.capture.uploads.colmap_model import count_images, model_suffix
from fastsplat.service.capture.uploads.left_out import LeftOut
from fastsplat.service.capture.uploads.named_files import FOLDERS_WITHOUT_PHOTOS
from fastsplat.service.capture.uploads.phones.polycam import find_polycam
from fastsplat.service.capture.uploads.phones.record3d import find_record3d
from fastsplat.service.capture.uploads.phones.scanner_app import find_scanner_app
from fastsplat.service.capture.uploads.splat_files.splat_reading import PLY_SUFFIX, is_splat_file
from fastsplat.service.capture.uploads.transforms import BLENDER_DOCUMENTS
from fastsplat.service.common.file_names import is_system_file, list_names
from fastsplat_contract.errors import InvalidInputError

VIDEO_SUFFIXES = frozenset({".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm"})
_LABEL_MAP_SUFFIXES = (".png", ".tif", ".tiff")
_POSE_SUFFIXES = (".json", ".xml", ".out", ".csv")
_UNSUPPORTED = {
    ".glb": ("glTF", "Save its splat as PLY with the program that made it"),
    ".obj": ("a mesh", "Send a splat, or the photos that the mesh was made from"),
} | dict.fromkeys(ARCHIVE_SUFFIXES, ("an archive in the archive", "Unpack it, and send one archive of its files"))
"""Unsupported files by suffix: their kind, and advice."""
_IMAGES = "images"
_SPLAT_FRAME = "dataparser_transforms.json"


@dataclass(frozen=True)
class UploadContents:
    """The parts of an upload, as paths relative to its folder; "" if absent."""

    source: Source
    images: tuple[str, ...]  # sorted candidates; with poses, possibly more than these name
    poses: str = ""  # transforms.json or the COLMAP model's folder
    image_folder: str = "."  # base of a COLMAP model's image names
    video: str = ""
    labels: str = ""  # labels.json
    label_maps: tuple[str, ...] = ()  # below labels/
    splats: tuple[str, ...] = ()  # an upload may have one
    splat_frame: str = ""  # nerfstudio's dataparser_transforms.json, from the poses' world to the splat's
    warnings: tuple[str, ...] = ()  # sentences for people about what is not used


def detect_kind(root: Path, left_out: LeftOut) -> UploadContents:
    """Detects the kind and parts of an upload.

    Precedence: transforms.json, COLMAP model, phone recording, splat, images. A shallower file wins over a deeper one.

    Args:
        left_out: receives photos of an unsupported format, unless poses name the photos.

    Raises:
        InvalidInputError: several videos, or nothing usable.
    """
    files = _files(root)
    if "means_l.webp" in {PurePosixPath(path).name for path in files}:
        raise InvalidInputError(
            "meta.json and means_l.webp are the parts of a SOG", field="meta.json", hint="Send them as one .sog file."
        )
    splats = tuple(path for path in files if is_splat_file(root / path))
    frame = _shallowest(path for path in files if PurePosixPath(path).name == _SPLAT_FRAME) if splats else ""
    labels = _shallowest(path for path in files if PurePosixPath(path).name == "labels.json")
    maps = tuple(
        path
        for path in files
        if "labels" in PurePosixPath(path).parts[:-1] and path.lower().endswith(_LABEL_MAP_SUFFIXES)
    )
    images = tuple(path for path in files if _suffix(path) in IMAGE_SUFFIXES and path not in maps)
    transforms = _shallowest(path for path in files if PurePosixPath(path).name == "transforms.json")
    transforms = transforms or _shallowest(path for path in files if PurePosixPath(path).name in BLENDER_DOCUMENTS)
    read = {labels, frame, *splats, *maps}
    if transforms:
        documents = (PurePosixPath(transforms).with_name(name).as_posix() for name in BLENDER_DOCUMENTS)
        warnings = _unread(files, {transforms, *read, *documents}, _POSE_SUFFIXES)
        return UploadContents("nerfstudio", images, transforms, ".", "", labels, maps, splats, frame, warnings)
    folders = {PurePosixPath(path).parent.as_posix() for path in files if PurePosixPath(path).stem == "cameras"}
    models = sorted(
        (folder for folder in folders if model_suffix(root / folder)),
        key=lambda folder: (-count_images(root / folder), len(PurePosixPath(folder).parts), folder),
    )
    if models:
        warnings = _unread(files, read, _POSE_SUFFIXES)
        if len(models) > 1:
            most = f"The upload has {len(models)} COLMAP models; only {models[0]} is used, which has the most images."
            warnings = (most, *warnings)
        folder = _image_folder(root, models[0])
        return UploadContents("colmap", images, models[0], folder, "", labels, maps, splats, frame, warnings)
    phone = _phone_recording(root, files)
    if phone is not None:
        return replace(phone, images=images, labels=labels, label_maps=maps, splats=splats)
    if splats:
        return UploadContents("splat", (), splats=splats, warnings=_unread(files, read))
    photos = _photos(images)
    videos = [path for path in files if _suffix(path) in VIDEO_SUFFIXES]
    _leave_unsupported_out(files, left_out)
    if not photos and len(videos) == 1:
        return UploadContents("video", (), video=videos[0], warnings=_unread(files, {*videos, *left_out.reasons}))
    if len(videos) > 1 and not photos:
        raise InvalidInputError(f"the upload has {len(videos)} videos", field=videos[1], hint="Send one video a scene.")
    if not photos:
        _refuse_others(files)
        raise left_out.refusal(
            InvalidInputError(
                "the upload has no images" + (f", but {list_names(files)}" if files else ""),
                field="files",
                hint="Send JPEG, PNG, WebP, TIFF, BMP or HEIC images, an archive of them, one video, a recording of "
                "Polycam, Record3D or 3D Scanner App, or a splat (PLY, SPZ, SOG, .splat or .ksplat).",
            )
        )
    warnings = _unread(files, {*photos, *read, *left_out.reasons})
    return UploadContents("images", photos, labels=labels, label_maps=maps, warnings=warnings)


def _phone_recording(root: Path, files: list[str]) -> UploadContents | None:
    """Detects a phone's recording and its poses."""
    if poses := find_polycam(root, files):
        return UploadContents("polycam", (), poses)
    if poses := find_record3d(files):
        return UploadContents("record3d", (), poses)
    if poses := find_scanner_app(files):
        return UploadContents("arkit", (), poses)
    return None


def _files(root: Path) -> list[str]:
    relative = (path.relative_to(root) for path in sorted(root.rglob("*")) if path.is_file())
    return [path.as_posix() for path in relative if not is_system_file(path.parts)]


def _unread(files: list[str], read: Collection[str], suffixes: Sequence[str] = ()) -> tuple[str, ...]:
    """Makes a sentence about unread files, if any; only those with `suffixes`, if given."""
    unread = [path for path in files if path not in read and (not suffixes or _suffix(path) in suffixes)]
    if not unread:
        return ()
    said = f"{len(unread)} files are not used: {list_names(unread)}."
    if any(_suffix(path) in _POSE_SUFFIXES for path in unread):
        said += " Poses are read from transforms.json, Blender's transforms_train.json, and COLMAP models alone."
    return (said,)


def _refuse_others(files: list[str]) -> None:
    """Explains why none of the files can be read."""
    for path in files:
        if _suffix(path) in _UNSUPPORTED:
            kind, way = _UNSUPPORTED[_suffix(path)]
            raise InvalidInputError(f"the upload has no images; {path} is {kind}", field=path, hint=f"{way}.")
    ply = next((path for path in files if _suffix(path) == PLY_SUFFIX), None)
    if ply is not None:
        raise InvalidInputError.of(
            ply,
            "is no splat: its header names no opacity and scale_0 of Gaussians",
            "Send a 3D Gaussian splatting PLY, a compressed PLY of SuperSplat or an SPZ file; points and meshes "
            "are none.",
        )


def _photos(images: tuple[str, ...]) -> tuple[str, ...]:
    """Drops masks and the like, and nerfstudio's reduced copies (images_2, images_4) beside originals."""
    photos = [path for path in images if not FOLDERS_WITHOUT_PHOTOS & set(PurePosixPath(path).parts[:-1])]
    originals = [path for path in photos if _IMAGES in PurePosixPath(path).parts[:-1]]
    return tuple(originals or photos)


def _image_folder(root: Path, model: str) -> str:
    """Finds the `images` folder beside or above the model; else the root."""
    for parent in (PurePosixPath(model), *PurePosixPath(model).parents):
        if (root / parent / _IMAGES).is_dir():
            return (parent / _IMAGES).as_posix()
    return "."


def _leave_unsupported_out(files: list[str], left_out: LeftOut) -> None:
    for path in files:
        if _suffix(path) in UNSUPPORTED_SUFFIXES:
            with left_out.costs(path):
                raise InvalidInputError.of(
                    path,
                    f"is of the kind {_suffix(path)[1:].upper()}, which is not supported",
                    "Export the photos as JPEG (phones: 'most compatible').",
                )


def _shallowest(paths: Iterable[str]) -> str:
    return min(paths, key=lambda path: (len(PurePosixPath(path).parts), path), default="")


def _suffix(path: str) -> str:
    return PurePosixPath(path).suffix.lower()
