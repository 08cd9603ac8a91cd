"""What an admitted upload says about itself, on disk, so that another process can build from it."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path

from fastsplat.service.capture.images import PhotoInfo
from fastsplat.service.capture.types import Source
from fastsplat_contract.errors import InvalidInputError

ADMITTED = ".admitted"
"""Name of the admitted folder, inside the raw upload's, so that both are removed together."""

FILES = "files"
_MANIFEST = "admitted.json"


@dataclass(frozen=True)
class Manifest:
    """What lies in the `FILES` folder of an admitted upload; all paths are relative to it.

    Attributes:
        source: how to read it.
        photos: all images in it that will be used, sorted by path.
        names: what each photo's view will be called.
        poses: the transforms.json or the COLMAP model's folder; "" for images alone.
        image_folder: what a COLMAP model's image names are relative to.
        video: the video, if it is one.
        labels: labels.json, if it holds the label table.
        label_maps: photo path to label map path.
        warnings: what was left aside.
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


def write_manifest(manifest: Manifest, folder: Path) -> None:
    """Write it into an admitted folder."""
    (folder / _MANIFEST).write_text(json.dumps(asdict(manifest)))


def read_manifest(folder: Path) -> tuple[Manifest, Path]:
    """The manifest and the folder of its files; `folder` is an admitted folder or the raw upload's around it.

    Raises:
        InvalidInputError: nothing was admitted there.
    """
    admitted = folder if folder.name == ADMITTED else folder / ADMITTED
    path = admitted / _MANIFEST
    if not path.is_file():
        raise InvalidInputError(f"{folder} holds no admitted upload", field="upload", hint="Send the upload again.")
    stored = json.loads(path.read_text())
    stored["photos"] = tuple(PhotoInfo(**photo) for photo in stored["photos"])
    stored["names"], stored["warnings"] = tuple(stored["names"]), tuple(stored["warnings"])
    return Manifest(**stored), admitted / FILES
