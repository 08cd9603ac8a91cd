"""What is kept of a capture with its scene besides small photos, and the capture that it makes again.

`photos/points.npz` has some sparse points of the capture, in the frame of the trained version, and the lenses of its
photos, and `photos/00000.valid.png` the mask of a photo that has one. Scenes of earlier releases have neither: they are
read without points, and black areas at a photo's edge count as what undistortion left empty.
"""

from __future__ import annotations

import zlib
from pathlib import Path
from zipfile import BadZipFile

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from fastsplat.service.capture.types import Capture, CaptureReport, View
from fastsplat.service.common.radial_lens import RadialLens
from fastsplat_contract.camera import PosedCamera
from fastsplat_contract.errors import SceneFileError
from fastsplat_contract.scenes import Scale

MAX_POINTS = 20_000
"""As many as training takes for anchors of the depth (`service.splatting.depth_regularization`)."""
_POINTS = "points.npz"
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
    for number, (view, size) in enumerate(zip(capture.views, sizes, strict=True)):
        if view.valid_path is not None:
            with Image.open(view.valid_path) as image:
                valid = image.convert("L").resize(size, Image.Resampling.BOX).point(lambda value: 255 * (value == 255))
            valid.save(_valid_path(photos, number), format="PNG", optimize=True)


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
                mask = None if rest.is_file() else _empty_border(np.asarray(image.convert("RGB")))
        except OSError as error:
            raise SceneFileError(f"the photo {path.name} is damaged", field=path.name) from error
        valid: Path | None = _valid_path(photos, number)
        if mask is not None and not mask.all():
            valid = scratch / f"{number:05d}.valid.png"
            Image.fromarray(np.where(mask, np.uint8(255), np.uint8(0))).save(valid)
        elif valid is not None and not valid.is_file():
            valid = None
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


def _valid_path(photos: Path, number: int) -> Path:
    return photos / f"{number:05d}.valid.png"


def _empty_border(rgb: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """bool [H, W]: False where a photo is black from its edge on, and a little beyond."""
    black = (rgb.max(axis=2) <= _BLACK).astype(np.uint8)
    _, areas = cv2.connectedComponents(black, connectivity=4)
    edge = np.unique(np.concatenate([areas[0], areas[-1], areas[:, 0], areas[:, -1]]))
    empty = (np.isin(areas, edge) & (black > 0)).astype(np.uint8)
    return np.asarray(cv2.dilate(empty, np.ones((_RINGING, _RINGING), np.uint8)) == 0)
