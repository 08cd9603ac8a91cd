"""The manifest of a validated upload: on disk, so that another process can build the capture from it."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

from fastsplat.service.capture.formats.image_io import PhotoInfo
from fastsplat.service.capture.types import Source
from fastsplat_contract.errors import InvalidInputError

VALIDATED = ".validated"
"""Name of the validated folder, inside the raw upload's, so that both are removed together."""
FILES = "files"
_MANIFEST = "validated.json"


@dataclass(frozen=True)
class UploadManifest:
    """What lies in the `FILES` folder of a validated upload; all paths are relative to it.

    Attributes:
        photos: all images in it that will be used, sorted by path.
        names: what each photo's view will be called.
        poses: the transforms.json or the COLMAP model's folder; "" for images alone.
        image_folder: what a COLMAP model's image names are relative to.
        video: the video, if it is one.
        labels: labels.json, if it has the label table.
        label_maps: photo path to label map path.
        warnings: what is not used, as sentences for people.
        splat: name of the splat file in the upload, whose arrays lie beside the folder as `SPLAT`; "" for none.
        gaussians: rows of the splat.
        depth_sizes: photo path to (width, height) of its depth map as stored, of photos that have one.
        splat_frame: the file that says how the splat's world lies in that of the poses, or "".
        spherical: whether the video's metadata say that it is an equirectangular one of 360°.
        metadata: by photo path, what photos without poses say of themselves; see `photo_metadata`. It has the places
            where they were taken, and goes with the upload.
        left_out: why files and frames are not used that were meant to be, by their names in the upload.
    """

    source: Source
    photos: tuple[PhotoInfo, ...] = ()
    names: tuple[str, ...] = ()
    poses: str = ""
    image_folder: str = "."
    video: str = ""
    labels: str = ""
    label_maps: dict[str, str] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    splat: str = ""
    gaussians: int = 0
    splat_frame: str = ""
    spherical: bool = False
    depth_sizes: dict[str, tuple[int, int]] = field(default_factory=dict)
    metadata: dict[str, dict[str, Any]] = field(default_factory=dict)
    left_out: dict[str, str] = field(default_factory=dict)


def write_manifest(manifest: UploadManifest, folder: Path) -> None:
    """Write the manifest into a validated folder."""
    (folder / _MANIFEST).write_text(json.dumps(asdict(manifest)))


def read_manifest(folder: Path) -> tuple[UploadManifest, Path]:
    """The manifest and the folder of its files; `folder` is a validated folder or the raw upload's around it. A process
    that met a stranger's bytes wrote them: every path must stay below that folder, and nothing be a link.

    Raises:
        InvalidInputError: there is no validated upload, or it leads elsewhere.
    """
    validated = folder if folder.name == VALIDATED else folder / VALIDATED
    path = validated / _MANIFEST
    if not path.is_file():
        raise InvalidInputError(f"{folder} has no validated upload", field="upload", hint="Send the upload again.")
    stored = json.loads(path.read_text())
    stored["photos"] = tuple(PhotoInfo(**photo) for photo in stored["photos"])
    stored["names"], stored["warnings"] = tuple(stored["names"]), tuple(stored["warnings"])
    stored["depth_sizes"] = {path: tuple(size) for path, size in stored["depth_sizes"].items()}
    manifest, files = UploadManifest(**stored), validated / FILES
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
