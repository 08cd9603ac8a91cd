"""Stores the manifest of a validated upload, so that another process can build its capture."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

from fastsplat.service.capture.captures import Source
from fastsplat.service.capture.formats.image_io import PhotoInfo
from fastsplat_contract.codec.json_codec import from_json, to_json
from fastsplat_contract.errors import InvalidInputError

VALIDATED = ".validated"
"""Validated folder inside the raw upload's, so that both are removed together."""
FILES = "files"
_MANIFEST = "validated.json"


@dataclass(frozen=True)
class UploadManifest:
    """Content of a validated upload's `FILES` folder; all paths are relative to it."""

    source: Source
    photos: tuple[PhotoInfo, ...] = ()  # all images to be used, sorted by path
    names: tuple[str, ...] = ()  # of the photos' views
    poses: str = ""  # transforms.json or the COLMAP model's folder; "" for images alone
    image_folder: str = "."  # base of a COLMAP model's image names
    video: str = ""
    labels: str = ""  # labels.json, if it has the label table
    label_maps: dict[str, str] = field(default_factory=dict)  # by photo path
    warnings: tuple[str, ...] = ()  # sentences for people about what is not used
    splat: str = ""  # splat file in the upload; its arrays lie beside the folder as `SPLAT`
    gaussians: int = 0  # rows of the splat
    splat_frame: str = ""  # file with the transform between the worlds of splat and poses
    spherical: bool = False  # the video's metadata say equirectangular, 360°
    depth_sizes: dict[str, tuple[int, int]] = field(default_factory=dict)  # (width, height) as stored, by photo path
    metadata: dict[str, dict[str, Any]] = field(default_factory=dict)  # see `photo_metadata`, by photo path
    """Of photos without poses; holds their GPS places and is deleted with the upload."""
    left_out: dict[str, str] = field(default_factory=dict)  # reasons, by names in the upload


def write_manifest(manifest: UploadManifest, folder: Path) -> None:
    """Write the manifest into a validated folder."""
    (folder / _MANIFEST).write_bytes(to_json(manifest))


def read_manifest(folder: Path) -> tuple[UploadManifest, Path]:
    """Reads the manifest and its files' folder from a validated folder or the upload around.

    A process that met untrusted bytes wrote it: paths must stay below that folder, and nothing may be a link.

    Raises:
        InvalidInputError: there is no validated upload, or it leads elsewhere.
    """
    validated = folder if folder.name == VALIDATED else folder / VALIDATED
    path = validated / _MANIFEST
    if not path.is_file():
        raise InvalidInputError(f"{folder} has no validated upload", field="upload", hint="Send the upload again.")
    manifest, files = from_json(UploadManifest, path.read_bytes()), validated / FILES
    photos = (name for photo in manifest.photos for name in (photo.path, manifest.label_maps.get(photo.path, "")))
    for name in (manifest.poses, manifest.image_folder, manifest.video, manifest.labels, *photos):
        if PurePosixPath(name).is_absolute() or ".." in PurePosixPath(name).parts:
            raise _leads_elsewhere(name)
    for place in (files, *files.rglob("*")):
        if place.is_symlink():
            raise _leads_elsewhere(place.name)
    return manifest, files


def _leads_elsewhere(name: str) -> InvalidInputError:
    return InvalidInputError(
        f"the validated upload leads to other files by {name[:80]!r}", field="upload", hint="Send the upload again."
    )
