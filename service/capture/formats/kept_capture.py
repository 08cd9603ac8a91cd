"""What is kept of a capture with its scene besides small photos, and the capture that it makes again.

`photos/points.npz` has some sparse points of the capture, in the frame of the trained version, and the lenses of its
photos, and `photos/00000.valid.png` the mask of a photo that has one. Scenes of earlier releases have neither: they are
read without points, and black areas at a photo's edge count as what undistortion left empty. Where label maps came with
the capture, `photos/labels.json` has its dictionary and `photos/00000.labels.png` the map of a photo that has one.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from zipfile import BadZipFile

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from fastsplat.service.capture.types import Capture, CaptureReport, GivenLabels, View
from fastsplat.service.common.atomic import link_or_copy
from fastsplat.service.common.dictionary import Dictionary, DictionaryEntry
from fastsplat.service.common.radial_lens import RadialLens
from fastsplat_contract.camera import PosedCamera
from fastsplat_contract.errors import SceneFileError
from fastsplat_contract.scenes import Scale

MAX_POINTS = 20_000
"""As many as training takes for anchors of the depth (`service.splatting.depth_regularization`)."""
_POINTS = "points.npz"
_LABELS = "labels.json"
_BLACK = 12
_RINGING = 9
"""Pixels beside a black area of a JPEG that are not to be trusted."""


def keep_rest(capture: Capture, photos: Path, sizes: list[tuple[int, int]]) -> None:
    """Write what `kept_capture` needs beside the photos.

    Args:
        capture: whose photos these are.
        photos: their folder.
        sizes: width and height of each photo's copy.
    """
    keep_points(capture, photos)
    for number, (view, size) in enumerate(zip(capture.views, sizes, strict=True)):
        if view.valid_path is not None:
            with Image.open(view.valid_path) as image:
                valid = image.convert("L").resize(size, Image.Resampling.BOX).point(lambda value: 255 * (value == 255))
            valid.save(valid_path(photos, number), format="PNG", optimize=True)
    if capture.given_labels is not None:
        _keep_labels(capture.given_labels, photos, sizes)


def keep_points(capture: Capture, photos: Path) -> None:
    """Write points and lenses of a capture.

    Args:
        capture: whose.
        photos: the folder of its photos.
    """
    rows = np.arange(len(capture.points))
    if len(rows) > MAX_POINTS:
        rows = np.sort(np.random.default_rng(6).choice(len(rows), MAX_POINTS, replace=False))
    lenses = [(view.lens.focal, view.lens.k1) if view.lens else (np.nan, np.nan) for view in capture.views]
    np.savez_compressed(
        photos / _POINTS,
        points=capture.points[rows],
        colors=capture.point_colors[rows],
        lenses=np.array(lenses, np.float64).reshape(-1, 2),
    )


def _keep_labels(labels: GivenLabels, photos: Path, sizes: list[tuple[int, int]]) -> None:
    (photos / _LABELS).write_text(json.dumps([asdict(entry) for entry in labels.dictionary.entries]))
    for number, (path, size) in enumerate(zip(labels.map_paths, sizes, strict=True)):
        if path is not None:
            with Image.open(path) as image:
                ids = np.asarray(image).astype(np.uint16)
            small = cv2.resize(ids, size, interpolation=cv2.INTER_NEAREST)
            if not cv2.imwrite(str(labels_path(photos, number)), small):
                raise OSError(f"{labels_path(photos, number)} could not be written")


def kept_capture(
    photos: Path,
    cameras: tuple[PosedCamera, ...],
    scale: Scale,
    held_out: tuple[str, ...],
    scratch: Path,
) -> Capture:
    """The capture that the photos of a scene make, without labels; its points are those of the trained version's frame.

    Args:
        photos: their folder.
        cameras: of the scene, in order; those without a photo are left out.
        scale: of the scene.
        held_out: names of the views that were never trained on.
        scratch: an existing folder for masks that are not stored.

    Raises:
        SceneFileError: a photo or the points are damaged.
    """
    views, rest = [], photos / _POINTS
    points, colors, lenses = _read_rest(rest)
    for number, posed in enumerate(cameras):
        path = photos / f"{number:05d}.jpg"
        if not path.is_file():
            continue
        try:
            with Image.open(path) as image:
                size = image.size
                mask = None if rest.is_file() else empty_border(np.asarray(image.convert("RGB")))
        except OSError as error:
            raise SceneFileError(f"the photo {path.name} is damaged", field=path.name) from error
        valid: Path | None = valid_path(photos, number)
        if valid is not None and not valid.is_file():
            valid = None
            if mask is not None and not mask.all():
                valid = scratch / f"{number:05d}.valid.png"
                Image.fromarray(np.where(mask, np.uint8(255), np.uint8(0))).save(valid)
        sized = PosedCamera(posed.camera.scaled_to(*size), posed.world_from_camera, posed.name)
        views.append(View(sized, path, valid, lens=lenses.get(number)))
    report = CaptureReport("images", len(views))
    return Capture(tuple(views), points, colors, scale, report, test_names=held_out)


def kept_lenses(photos: Path) -> tuple[RadialLens, ...]:
    """The lenses of those photos of a scene of which they are known.

    Args:
        photos: their folder.

    Raises:
        SceneFileError: the file that has them is damaged.
    """
    return tuple(_read_rest(photos / _POINTS)[2].values())


def kept_labels(photos: Path) -> Dictionary | None:
    """The dictionary of the label maps that are kept with the photos of a scene; None where none are.

    Args:
        photos: their folder.

    Raises:
        SceneFileError: the file that has it is damaged.
    """
    path = photos / _LABELS
    if not path.is_file():
        return None
    try:
        rows = json.loads(path.read_text())
        return Dictionary(tuple(DictionaryEntry(**{**row, "aliases": tuple(row["aliases"])}) for row in rows))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise SceneFileError("the kept labels are damaged", field=path.name) from error


def share_labels(source: Path, target: Path, numbers: Sequence[int]) -> GivenLabels | None:
    """Make the label maps of some photos of a scene those of another folder; None where none are kept.

    Args:
        source: folder of the photos.
        target: folder of the others.
        numbers: which photos of the source the others are, in their order.

    Raises:
        SceneFileError: as `kept_labels`.
    """
    dictionary = kept_labels(source)
    if dictionary is None:
        return None
    link_or_copy(source / _LABELS, target / _LABELS)
    paths: list[Path | None] = []
    for place, number in enumerate(numbers):
        before, path = labels_path(source, number), labels_path(target, place)
        if before.is_file():
            link_or_copy(before, path)
        paths.append(path if before.is_file() else None)
    return GivenLabels(dictionary, tuple(paths))


def _read_rest(path: Path) -> tuple[NDArray[np.float32], NDArray[np.uint8], dict[int, RadialLens]]:
    """Points [P, 3], their colors [P, 3], and lenses by the photo's number; nothing where there is no file."""
    if not path.is_file():
        return np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8), {}
    try:
        with np.load(path, allow_pickle=False) as file:
            rows = file["lenses"].tolist() if "lenses" in file else []
            lenses = {number: RadialLens(*row) for number, row in enumerate(rows) if np.isfinite(row).all()}
            return file["points"], file["colors"], lenses
    except (OSError, EOFError, ValueError, KeyError, TypeError, BadZipFile, zlib.error) as error:
        raise SceneFileError("the kept points are damaged", field=path.name) from error


def valid_path(photos: Path, number: int) -> Path:
    """Where the mask of a photo is, by its number from 0, if it has one."""
    return photos / f"{number:05d}.valid.png"


def labels_path(photos: Path, number: int) -> Path:
    """Where the label map of a photo is, by its number from 0, if it is kept: a PNG of one 16-bit channel."""
    return photos / f"{number:05d}.labels.png"


def empty_border(rgb: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """bool [H, W] of a photo [H, W, 3]: False where it is black from its edge on, and a little beyond."""
    black = (rgb.max(axis=2) <= _BLACK).astype(np.uint8)
    _, areas = cv2.connectedComponents(black, connectivity=4)
    edge = np.unique(np.concatenate([areas[0], areas[-1], areas[:, 0], areas[:, -1]]))
    empty = (np.isin(areas, edge) & (black > 0)).astype(np.uint8)
    return np.asarray(cv2.dilate(empty, np.ones((_RINGING, _RINGING), np.uint8)) == 0)
