"""From a folder to a `Dataset`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray

from benchmarks.evaluation.datasets.annotations import Annotation, Annotations, find_annotations
from benchmarks.evaluation.datasets.dataset import Dataset, QueryTruth, TrueView
from benchmarks.evaluation.datasets.layout import Layout, read_layout
from benchmarks.evaluation.localization import box_of
from benchmarks.evaluation.validation_split import Split, validation_names
from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.formats.image_io import check_image, load_upright
from fastsplat.service.capture.formats.reduced_images import reduce, reduce_ids
from fastsplat.service.capture.photos.camera_model import aspect_error
from fastsplat.service.capture.untrusted.image_decoding import load_upright_map
from fastsplat.service.capture.uploads.label_maps import check_label_map
from fastsplat.service.capture.uploads.posed_input import PosedImage
from fastsplat.service.capture.views.view_writer import ViewGeometry, view_geometry
from fastsplat.service.common.dictionary import Dictionary, dictionary_of
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.geometry.camera import PosedCamera

TEST_EVERY = 8


def read_dataset(
    folder: Path,
    settings: CaptureSettings,
    *,
    test_every: int = TEST_EVERY,
    mask_label: str = "",
    split: Split = "test",
) -> Dataset:
    """The split of a data set and the truth of its test views. All of it is read and checked here, before anybody
    trains for minutes.

    Layouts: a `transforms.json` with label maps, depth maps and a split, as far as it has them; a COLMAP model with
    images (and `labels.json` + `labels/*.png`, or `masks/*.png` with `mask_label`); LERF-OVS, LERF-Mask and 3D-OVS. The
    test views are those that the folder names; else those that are annotated, which are then never trained on; else
    every `test_every`-th by name, from the first on (the custom of Mip-NeRF 360 and 3DGS).

    Args:
        folder: the data set; nothing in it is changed.
        settings: limits of the capture room, and the size that images are reduced to.
        test_every: see above.
        mask_label: name of what the binary masks show. Without it, masks of a folder without labels say which pixels
            count at all.
        split: `validation` leaves the test views aside and takes some of the training views in their place (see
            `validation_names`), which are then not trained on: by these, settings are chosen. Annotated sets have no
            truth of training views but their pictures.

    Raises:
        NotFoundError: no such folder.
        InvalidInputError, CorruptImageError, LimitExceededError: malformed; the message names the file.
    """
    if test_every < 2:
        raise InvalidInputError(
            f"every {test_every}th view for testing", field="test_every", limit="2 or more", hint="Say 8."
        )
    layout = read_layout(folder, mask_label, settings)
    annotations = None if mask_label else find_annotations(folder, settings)
    names = [photo.name for photo in layout.poses.images]
    if annotations is not None:
        return _annotated(layout, annotations, names, settings, split)
    photos = {photo.name: photo for photo in layout.poses.images}
    dictionary = layout.labels.dictionary() if layout.labels is not None else Dictionary(())
    train, measured = _divided(layout, names, set(layout.poses.test_names or names[::test_every]), split)
    test = tuple(_true_view(layout, photos[name], settings) for name in names if name in measured)
    return Dataset(
        folder=folder,
        kind="nerfstudio" if layout.contents.source == "nerfstudio" else "colmap",
        dictionary=dictionary,
        train=train,
        test=test,
        mask_label=mask_label,
        notes=_notes(layout, test),
        instances=layout.instances,
        split=split,
    )


def _annotated(
    layout: Layout, annotations: Annotations, names: list[str], settings: CaptureSettings, split: Split
) -> Dataset:
    by_stem: dict[str, PosedImage] = {}
    for photo in layout.poses.images:
        stem = _stem(photo.name)
        if stem in by_stem and stem in annotations.frames:
            raise InvalidInputError(
                f"two images are called {stem}, which is annotated once", field=stem, hint="Give images names."
            )
        by_stem[stem] = photo
    photos = _photo_paths(layout)
    if annotations.kind == "3d_ovs" and not set(annotations.frames) & {_stem(path) for path in photos}:
        by_stem = _by_position(photos, by_stem)
    if annotations.kind == "lerf_mask":
        trained = {path.stem for path in (layout.root / "images_train").glob("*")}
        tested = sorted(by_stem.keys() - trained)
        by_stem |= {str(position): by_stem[stem] for position, stem in enumerate(tested)}
    plain = replace(layout, labels=None, label_maps={})
    annotated = {by_stem[stem].name for stem in annotations.frames if stem in by_stem}
    train, measured = _divided(layout, names, annotated | set(layout.poses.test_names), split)
    notes = annotations.notes
    if split == "validation":
        test = [_true_view(plain, photo, settings) for photo in layout.poses.images if photo.name in measured]
        notes += ("Only test views are annotated: validation views count for pictures only.",)
    else:
        test = [_annotated_view(plain, by_stem.get(stem), stem, annotations, settings) for stem in annotations.frames]
        notes += tuple(
            f"{view.name} is annotated, but has no pose: its answers are missing and count as zero."
            for view in test
            if view.posed is None
        )
    return Dataset(
        folder=layout.root,
        kind=annotations.kind,
        dictionary=dictionary_of(annotations.texts),
        train=train,
        test=tuple(sorted(test, key=lambda view: view.name)),
        notes=notes,
        split=split,
    )


def _annotated_view(
    layout: Layout, posed_image: PosedImage | None, stem: str, annotations: Annotations, settings: CaptureSettings
) -> TrueView:
    frame = annotations.frames[stem]
    if posed_image is not None:
        return _with_queries(layout, posed_image, frame, settings)
    return TrueView(stem, None, queries=tuple(_unplaced(annotation) for annotation in frame))


def _divided(layout: Layout, names: list[str], test: set[str], split: Split) -> tuple[tuple[str, ...], set[str]]:
    """The names to train on, and those to measure."""
    train = _train_names(layout, names, test)
    if split == "test":
        return train, test
    poses = {photo.name: photo.world_from_camera for photo in layout.poses.images}
    measured = set(validation_names(train, [poses[name] for name in train]))
    return tuple(name for name in train if name not in measured), measured


def _photo_paths(layout: Layout) -> tuple[str, ...]:
    """All images in the folders of the posed ones, those without a pose too, in the order of their paths."""
    homes = {PurePosixPath(photo.path).parent for photo in layout.poses.images}
    return tuple(sorted(path for path in layout.contents.images if PurePosixPath(path).parent in homes))


def _by_position(paths: tuple[str, ...], by_stem: Mapping[str, PosedImage]) -> dict[str, PosedImage]:
    """The posed images by their position among all images in the order of their paths, as the number of a frame is
    meant where images have other names (`LLFFDataset` of 3D-OVS); with leading zeros or without."""
    photos = {photo.path: photo for photo in by_stem.values()}
    named: dict[str, PosedImage] = {}
    for position, path in enumerate(paths):
        if path in photos:
            named |= {f"{position:0{width}d}": photos[path] for width in range(1, 6)}
    return named


def _stem(path: str) -> str:
    return PurePosixPath(path).stem


def _train_names(layout: Layout, names: list[str], test: set[str]) -> tuple[str, ...]:
    if layout.listed_train is None:
        return tuple(name for name in names if name not in test)
    return tuple(name for name in names if name in layout.listed_train)


def _true_view(layout: Layout, posed_image: PosedImage, settings: CaptureSettings) -> TrueView:
    root = layout.root
    photo = check_image(root, posed_image.path, settings)
    camera_model = posed_image.camera_model
    if not camera_model.fits(*photo.upright_size) and not camera_model.fits(photo.width, photo.height):
        raise aspect_error(posed_image.path, camera_model, photo.width, photo.height)
    placed = view_geometry(posed_image, photo, settings)
    way, (width, height) = placed.undistortion, placed.size

    def upright(name: str) -> NDArray[np.uint16]:
        return way.apply_to_ids(load_upright_map(root, name, photo, placed.size, settings))

    valid = way.valid(width, height)
    if posed_image.path in layout.masks:
        counted = upright(layout.masks[posed_image.path]) > 0
        valid = counted if valid is None else valid & counted
    labels = depth = None
    if posed_image.path in layout.label_maps and layout.labels is not None:
        name = layout.label_maps[posed_image.path]
        if layout.binary:
            labels = (upright(name) > 0).astype(np.int32)
        else:
            sizes = {photo.upright_size, (photo.width, photo.height)}
            check_label_map(root, name, layout.labels, sizes, settings)
            labels = layout.labels.translate(upright(name)).astype(np.int32)
    if posed_image.path in layout.depths:
        depth = (upright(layout.depths[posed_image.path]) * layout.depth_unit).astype(np.float32)
    instances = None
    if posed_image.path in layout.instance_maps and layout.instances:
        name = layout.instance_maps[posed_image.path]
        instances = upright(name).astype(np.int32)
        if int(instances.max(initial=0)) > len(layout.instances):
            raise InvalidInputError(
                f"{name} has the object {int(instances.max())} of {len(layout.instances)}",
                field=name,
                hint="Name every object in the list of instances.",
            )
    return TrueView(
        name=posed_image.name,
        posed=PosedCamera(way.camera, placed.world_from_camera, posed_image.name),
        rgb=way.apply(reduce(load_upright(root, photo, settings), placed.size)),
        valid=valid,
        labels=labels,
        depth=depth,
        instances=instances,
    )


def _with_queries(
    layout: Layout, posed_image: PosedImage, frame: tuple[Annotation, ...], settings: CaptureSettings
) -> TrueView:
    view = _true_view(layout, posed_image, settings)
    photo = check_image(layout.root, posed_image.path, settings)
    placed = view_geometry(posed_image, photo, settings)
    for annotation in frame:
        for mask in annotation.instances:
            _check_aspect(mask, photo.upright_size, f"{posed_image.name}: {annotation.text}")
    return replace(view, queries=tuple(filter(None, (_placed(annotation, placed) for annotation in frame))))


def _placed(annotation: Annotation, placed: ViewGeometry) -> QueryTruth | None:
    """The text's truth in the view's pixels, or None where it is not seen."""
    masks = [
        placed.undistortion.apply_to_ids(reduce_ids(mask.astype(np.uint16), placed.size)) > 0
        for mask in annotation.instances
    ]
    boxes = tuple(box for box in map(box_of, masks) if box is not None)
    return QueryTruth(annotation.text, np.logical_or.reduce(masks), boxes) if boxes else None


def _unplaced(annotation: Annotation) -> QueryTruth:
    boxes = tuple(box for box in map(box_of, annotation.instances) if box is not None)
    mask = np.logical_or.reduce(annotation.instances) if annotation.instances else np.zeros((1, 1), np.bool_)
    return QueryTruth(annotation.text, mask, boxes)


def _check_aspect(mask: NDArray[np.bool_], size: tuple[int, int], where: str) -> None:
    height, width = mask.shape
    if abs(width * size[1] - height * size[0]) > max(*size, width, height):
        raise InvalidInputError(
            f"{where} is annotated on {width}×{height} pixels, its image has {size[0]}×{size[1]}: another aspect",
            field=where,
            hint="Bring the images that were annotated, or a resized, never a cropped version.",
        )


def _notes(layout: Layout, test: tuple[TrueView, ...]) -> tuple[str, ...]:
    without = [view.name for view in test if view.labels is None]
    if layout.labels is None or not without:
        return ()
    return (f"{len(without)} of {len(test)} test views have no label map and count for pictures only.",)
