"""Which images a posed folder has, which of them are for testing, and where their truths lie."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.formats.bounded_json import read_json
from fastsplat.service.capture.uploads.label_maps import LabelTable, match_label_maps, read_label_table
from fastsplat.service.capture.uploads.left_out import LeftOut
from fastsplat.service.capture.uploads.named_files import NamedFiles
from fastsplat.service.capture.uploads.posed_input import PosedDataset, PosedImage
from fastsplat.service.capture.uploads.posed_validation import ImageSizes, read_posed_dataset
from fastsplat.service.capture.uploads.transforms import name_keys
from fastsplat.service.capture.uploads.upload_kind import UploadContents, detect_kind
from fastsplat_contract.errors import InvalidInputError, NotFoundError

_UNIT = re.compile(r"\s*([0-9.]+(?:e[+-]?[0-9]+)?)\s*(?:m\b|met)?", re.IGNORECASE)
_NERFSTUDIO_DEPTH_UNIT = 1e-3  # its default: millimeters


@dataclass(frozen=True)
class Layout:
    """A posed folder before any pixel is read.

    Attributes:
        root: the folder.
        contents: its parts.
        poses: cameras, poses and points.
        labels: names of the ids in the label maps; None without label maps.
        label_maps: label map by image path, relative to the root.
        binary: whether the label maps are masks: 0 or the one label.
        masks: mask whose zeros are to be ignored, by image path.
        depths: depth map by image path.
        depth_unit: scene units of one step of the depth maps.
        listed_train: names that the folder sets apart for training; None if it does not say.
        instances: the label of each object, from 1; empty if the folder does not tell objects of one label apart.
        instance_maps: map of objects by image path.
    """

    root: Path
    contents: UploadContents
    poses: PosedDataset
    labels: LabelTable | None = None
    label_maps: Mapping[str, str] = field(default_factory=dict)
    binary: bool = False
    masks: Mapping[str, str] = field(default_factory=dict)
    depths: Mapping[str, str] = field(default_factory=dict)
    depth_unit: float = 1.0
    listed_train: frozenset[str] | None = None
    instances: tuple[str, ...] = ()
    instance_maps: Mapping[str, str] = field(default_factory=dict)


def read_layout(root: Path, mask_label: str, settings: CaptureSettings) -> Layout:
    """Raises as `read_dataset`."""
    if not root.is_dir():
        raise NotFoundError(f"there is no folder {root}", field="data set", hint="Name a data set's folder.")
    contents = detect_kind(root, LeftOut(strict=True))
    if contents.source not in ("nerfstudio", "colmap"):
        raise InvalidInputError(
            f"{root.name} has no poses",
            field="data set",
            hint="A data set needs a transforms.json or a COLMAP model beside its images.",
        )
    poses = read_posed_dataset(root, contents, ImageSizes(root, contents.images, settings), settings)
    document = read_json(root / contents.poses, contents.poses, settings) if contents.source == "nerfstudio" else {}
    table, maps = poses.labels, {p.path: p.label_map for p in poses.images if p.label_map is not None}
    masks = {photo.path: photo.mask for photo in poses.images if photo.mask is not None}
    if table is None and contents.labels and not mask_label:
        missing = [image.path for image in poses.missing]
        maps = match_label_maps(contents.label_maps, [photo.path for photo in poses.images], missing)
        table = read_label_table(root, contents.labels, settings) if maps else None
    if mask_label:
        if table is not None:
            raise InvalidInputError(
                f"{root.name} names its labels itself", field="mask_label", hint="Leave the mask label out."
            )
        table = LabelTable((mask_label,), (1,))
        maps, masks = masks or _masks_beside(root, poses.images), {}
        if not maps:
            raise InvalidInputError(
                f"{root.name} has no masks to call {mask_label!r}",
                field="mask_label",
                hint="Give frames a mask_path, or put masks/<image name>.png beside the images.",
            )
    return Layout(
        root=root,
        contents=contents,
        poses=poses,
        labels=table if maps else None,
        label_maps=maps if table is not None else {},
        binary=bool(mask_label),
        masks=masks,
        depths=_paths(root, contents.poses, document, poses.images, ("depth_path", "depth_file_path"), "depth path"),
        depth_unit=_depth_unit(document, contents.poses),
        listed_train=_listed_train(document, contents.poses, poses),
        instances=_instances(document, contents.poses),
        instance_maps=_paths(root, contents.poses, document, poses.images, ("instance_path",), "instance path"),
    )


def frames_by_path(document: Any, name: str, photos: tuple[PosedImage, ...]) -> dict[str, Mapping[str, Any]]:
    """A transforms.json's frames by their image's path relative to the folder."""
    stems = {PurePosixPath(photo.path).with_suffix("").as_posix(): photo.path for photo in photos}
    paths = {photo.path for photo in photos}
    by_path = {}
    for frame in document.get("frames", []):
        key = _normal(PurePosixPath(name).parent / frame["file_path"])
        path = key if key in paths else stems.get(key)
        if path is not None:
            by_path[path] = frame
    return by_path


def _masks_beside(root: Path, photos: tuple[PosedImage, ...]) -> dict[str, str]:
    """`masks/<name>.png` or COLMAP's own `masks/<name>.jpg.png`."""
    by_path = {}
    for photo in photos:
        named = PurePosixPath("masks") / photo.name
        for candidate in (named.with_suffix(".png"), PurePosixPath(f"{named}.png")):
            if (root / candidate).is_file():
                by_path[photo.path] = NamedFiles(root, "masks").file(".", candidate.as_posix(), photo.name)
    return by_path


def _paths(
    root: Path, name: str, document: Any, photos: tuple[PosedImage, ...], keys: tuple[str, ...], what: str
) -> dict[str, str]:
    """The file that each frame names under the first of these keys that it has, by image path."""
    by_path = {}
    for path, frame in frames_by_path(document, name, photos).items():
        stated = next((frame[key] for key in keys if frame.get(key) is not None), None)
        if stated is None:
            continue
        where = f"{name}: {path}"
        if not isinstance(stated, str):
            raise InvalidInputError(f"{where}: the {what} is no text", field=where, hint="Name a file.")
        by_path[path] = NamedFiles(root, name).file(PurePosixPath(name).parent.as_posix(), stated, where)
    return by_path


def _instances(document: Any, name: str) -> tuple[str, ...]:
    stated = document.get("instances", [])
    if not isinstance(stated, list) or not all(isinstance(label, str) for label in stated):
        raise InvalidInputError(
            f"{name}: the instances are no list of names",
            field=f"{name}: instances",
            hint="Give the label of each object, in the order of the ids in the instance maps.",
        )
    return tuple(stated)


def _depth_unit(document: Any, name: str) -> float:
    """ "depth_unit": meters a step, a number or a text that begins with one; nerfstudio: depth_unit_scale_factor."""
    stated = document.get("depth_unit", document.get("depth_unit_scale_factor", _NERFSTUDIO_DEPTH_UNIT))
    match = _UNIT.match(stated) if isinstance(stated, str) else None
    try:
        unit = float(match.group(1) if match else stated)
    except (TypeError, ValueError):
        unit = math.nan
    if not 0 < unit < 1e6:
        raise InvalidInputError(
            f"{name}: the depth unit is {str(stated)[:60]!r}",
            field=f"{name}: depth_unit",
            hint="Say how many scene units one step of the depth maps is, e.g. 0.001.",
        )
    return unit


def _listed_train(document: Any, name: str, poses: PosedDataset) -> frozenset[str] | None:
    split = document.get("split")
    listed = split.get("train") if isinstance(split, dict) else document.get("train_filenames")
    if listed is None:
        return None
    by_key = {key: image.name for image in poses.images for key in name_keys(image.name)}
    missing = {key for image in poses.missing for key in name_keys(image.name)}
    if not isinstance(listed, list) or not all(isinstance(item, str) for item in listed):
        raise InvalidInputError(
            f"{name}: the training split is no list of names", field=name, hint="Give a list of file names."
        )
    keys = [item.removeprefix("./") for item in listed]
    unknown = [key for key in keys if key not in by_key and key not in missing]
    if unknown:
        raise InvalidInputError(
            f"{name}: the training split names {unknown[0][:80]!r}, which no frame shows",
            field=name,
            hint="Name frames by their file_path.",
        )
    return frozenset(by_key[key] for key in keys if key in by_key)


def _normal(path: PurePosixPath) -> str:
    parts: list[str] = []
    for part in path.parts:
        if part == ".." and parts:
            parts.pop()
        elif part != ".":
            parts.append(part)
    return "/".join(parts)
