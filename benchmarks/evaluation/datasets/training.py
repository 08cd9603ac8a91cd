"""The part of a data set that a scene may be trained on, checked and built as any upload is."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

from benchmarks.evaluation.datasets.dataset import Dataset
from benchmarks.evaluation.datasets.layout import Layout, frames_by_path, read_layout
from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.captures import Capture
from fastsplat.service.capture.formats.bounded_json import read_json
from fastsplat.service.capture.formats.image_io import open_map
from fastsplat.service.common.file_names import common_folder
from fastsplat.service.common.files import link_or_copy
from fastsplat.service.common.progress import Progress
from fastsplat.service.jobs.create_scene import capture_folder
from fastsplat_contract.errors import InvalidInputError

_MASKS = "mask_labels"


def training_capture(dataset: Dataset, work: Path, settings: CaptureSettings, progress: Progress) -> Capture:
    """The training views alone, with their points and label maps, built below `work`.

    A transforms.json is handed over without its test frames, so that points that have to be triangulated come from
    training images only. A COLMAP model's points are taken as they are: its author saw all images.

    Raises:
        InvalidInputError: no training views.
        FastSplatError: as `capture_folder`.
    """
    if not dataset.train:
        raise InvalidInputError(
            f"{dataset.folder.name} has no training views", field="split", hint="Give it more images."
        )
    layout = read_layout(dataset.folder, dataset.mask_label, settings)
    staged = work / "upload"
    staged.mkdir(parents=True)
    _stage(layout, dataset, staged, settings)
    capture = capture_folder(staged, work / "capture", settings, progress)
    names = {view.posed.name for view in capture.views}  # images that are masked entirely are no views
    return subset(capture, tuple(name for name in dataset.train if name in names))


def subset(capture: Capture, names: tuple[str, ...]) -> Capture:
    """The views of these names, in the capture's order; points stay.

    Raises:
        InvalidInputError: a name that is no view.
    """
    missing = sorted(set(names) - {view.posed.name for view in capture.views})
    if missing:
        raise InvalidInputError(f"the capture has no view {missing[0]}", field="names")
    rows = [index for index, view in enumerate(capture.views) if view.posed.name in set(names)]
    labels = capture.given_labels
    if labels is not None:
        labels = replace(labels, map_paths=tuple(labels.map_paths[row] for row in rows))
        labels = labels if any(labels.map_paths) else None
    return replace(capture, views=tuple(capture.views[row] for row in rows), given_labels=labels, test_names=())


def _stage(layout: Layout, dataset: Dataset, target: Path, settings: CaptureSettings) -> None:
    photos = layout.poses.images
    if layout.contents.source == "nerfstudio":
        photos = tuple(photo for photo in photos if photo.name in set(dataset.train))
    for photo in photos:
        _place(layout.root, photo.path, target)
        for extra in (layout.masks.get(photo.path), None if dataset.mask_label else layout.label_maps.get(photo.path)):
            if extra is not None:
                _place(layout.root, extra, target)
    binary = {}
    if dataset.mask_label:
        selected = [photo for photo in photos if photo.name in set(dataset.train) and photo.path in layout.label_maps]
        binary = {photo.path: _binary(layout, photo.path, target, settings) for photo in selected}
    if layout.contents.source == "colmap":
        _stage_colmap(layout, dataset, target, binary)
    else:
        _stage_transforms(layout, dataset, target, binary, settings)


def _stage_colmap(layout: Layout, dataset: Dataset, target: Path, binary: dict[str, str]) -> None:
    for part in ("cameras", "images", "points3D"):
        for suffix in (".bin", ".txt"):
            name = f"{layout.contents.poses}/{part}{suffix}"
            if (layout.root / name).is_file():
                _place(layout.root, name, target)
    if dataset.mask_label:
        (target / "labels").mkdir()
        (target / "labels" / "labels.json").write_text(json.dumps({dataset.mask_label: 1}))
        common = common_folder(photo.path for photo in layout.poses.images)
        for path, mask in binary.items():
            home = target / "labels" / Path(path).relative_to(common).with_suffix(".png")
            home.parent.mkdir(parents=True, exist_ok=True)
            (target / mask).rename(home)
    elif layout.label_maps:
        _place(layout.root, layout.contents.labels, target)


def _stage_transforms(
    layout: Layout, dataset: Dataset, target: Path, binary: dict[str, str], settings: CaptureSettings
) -> None:
    name = layout.contents.poses
    document = read_json(layout.root / name, name, settings)
    home = Path(name).parent
    selected = set(dataset.train)
    by_path = frames_by_path(document, name, layout.poses.images)
    frames = []
    for photo in layout.poses.images:
        if photo.name not in selected:
            continue
        frame = dict(by_path[photo.path])
        frame.pop("depth_file_path", None)  # a truth to measure by, not a sensor's word to train on
        if dataset.mask_label:
            frame.pop("mask_path", None)
            if photo.path in binary:
                frame["mask_path"] = os.path.relpath(binary[photo.path], home)
        frames.append(frame)
    document["frames"] = frames
    for key in ("split", "test_filenames", "train_filenames", "val_filenames"):
        document.pop(key, None)
    if dataset.mask_label:
        document["labels"] = {dataset.mask_label: 1}
    (target / name).parent.mkdir(parents=True, exist_ok=True)
    (target / name).write_text(json.dumps(document))
    for points in (document.get("ply_file_path"), "points3d.ply"):
        path = (home / points).as_posix() if isinstance(points, str) else ""
        if path and (layout.root / path).is_file():
            _place(layout.root, path, target)
    if layout.contents.labels and "labels" not in document:
        _place(layout.root, layout.contents.labels, target)


def _binary(layout: Layout, path: str, target: Path, settings: CaptureSettings) -> str:
    """A mask of 0 and anything, stored as a label map of 0 and 1."""
    mask = open_map(layout.root, layout.label_maps[path], settings) > 0
    name = f"{_MASKS}/{Path(path).with_suffix('.png').as_posix()}"
    (target / name).parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(mask.astype(np.uint8)).save(target / name)
    return name


def _place(root: Path, name: str, target: Path) -> None:
    home = target / name
    if home.exists():
        return
    home.parent.mkdir(parents=True, exist_ok=True)
    link_or_copy(root / name, home)
