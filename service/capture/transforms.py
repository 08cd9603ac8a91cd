"""Reads nerfstudio's transforms.json (https://docs.nerf.studio/quickstart/data_conventions.html)."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.capture.colmap_model import inside
from fastsplat.service.capture.documents import read_json
from fastsplat.service.capture.given import GivenPhoto, GivenPoses, no_points
from fastsplat.service.capture.images import IMAGE_SUFFIXES
from fastsplat.service.capture.labels import LabelTable, label_table
from fastsplat.service.capture.lens import Lens, check_lens
from fastsplat.service.capture.ply_points import read_points
from fastsplat.service.capture.settings import CaptureSettings
from fastsplat_contract.camera import check_rigid
from fastsplat_contract.errors import InvalidInputError, LimitExceededError
from fastsplat_contract.scenes import Scale

_OPENCV_FROM_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
_POSE_HINT = "Give a rigid 4×4 world-from-camera matrix of finite numbers, or remove the frame."
_OPENCV_KEYS = ("k1", "k2", "p1", "p2")
_FISHEYE_KEYS = ("k1", "k2", "k3", "k4")
_PINHOLES = ("PINHOLE", "SIMPLE_PINHOLE")
_PERSPECTIVES = ("OPENCV", "FULL_OPENCV", "RADIAL", "SIMPLE_RADIAL", *_PINHOLES)


@dataclass(frozen=True)
class _Document:
    folder: str
    name: str
    top: Mapping[str, Any]
    opengl: bool
    labels: LabelTable | None


def read_transforms(
    root: Path, name: str, sizes: Mapping[str, tuple[int, int]], settings: CaptureSettings
) -> GivenPoses:
    """Cameras, poses, points and label maps of a transforms.json.

    Poses are world-from-camera, in OpenGL axes (x right, y up, z backward) unless "convention" says "opencv". With
    "labels" in the document, a frame's "mask_path" is its label map; without, it is nerfstudio's mask, whose zeros are
    pixels to ignore.

    Args:
        root: the upload's folder; `name` is the document in it.
        sizes: (width, height) of the images as stored, by path, for documents that do not say "w" and "h".

    Raises:
        InvalidInputError: a pose that is missing, singular, scaled or not finite, a missing file or focal length, an
            unknown camera model or convention. The message names the frame.
        LimitExceededError: the document or its points are larger than the settings allow.
    """
    top = read_json(root / name, name, settings)
    frames = top.get("frames") if isinstance(top, dict) else None
    if not isinstance(frames, list) or not frames:
        raise InvalidInputError(f"{name} has no list of frames", field=name, hint="Give one frame an image.")
    if len(frames) > settings.max_images:
        raise LimitExceededError(
            f"{name} has {len(frames)} frames",
            field=name,
            limit=f"{settings.max_images} images (FASTSPLAT_CAPTURE__MAX_IMAGES)",
            hint="Send fewer images.",
        )
    labels = label_table(top["labels"], field=f"{name}: labels") if "labels" in top else None
    opengl = _is_opengl(top.get("convention", "opengl"), name)
    document = _Document(PurePosixPath(name).parent.as_posix(), name, top, opengl, labels)
    photos = sorted(
        (_photo(root, document, index, frame, sizes) for index, frame in enumerate(frames)),
        key=lambda photo: photo.name,
    )
    if len({photo.path for photo in photos}) < len(photos):
        raise InvalidInputError(f"{name}: two frames show the same file", field=name, hint="Give each image one frame.")
    points, colors = _points(root, document, settings)
    return GivenPoses(
        photos=tuple(photos),
        points=points,
        point_colors=colors,
        scale=_scale(top),
        labels=labels,
        test_names=_test_names(document, [photo.name for photo in photos]),
    )


def _photo(root: Path, document: _Document, index: int, frame: Any, sizes: Mapping[str, tuple[int, int]]) -> GivenPhoto:
    where = f"{document.name}: frame {index}"
    if not isinstance(frame, dict) or not isinstance(frame.get("file_path"), str):
        raise InvalidInputError(f"{where} has no file_path", field=where, hint="Name the frame's image.")
    file_path = frame["file_path"]
    where = f"{where} ({file_path[:120]})"
    path = _image(root, document.folder, file_path, where)
    if path not in sizes:
        raise InvalidInputError(f"{where} is no image", field=where, hint="Send JPEG, PNG, WebP, TIFF or BMP images.")
    extra = {}
    mask = frame.get("mask_path")
    if mask is not None:
        if not isinstance(mask, str):
            raise InvalidInputError(f"{where} has a mask_path that is no text", field=where, hint="Name a file.")
        key = "mask" if document.labels is None else "label_map"
        extra[key] = inside(root, document.folder, mask, where)
    return GivenPhoto(
        name=PurePosixPath(path).relative_to(document.folder).as_posix() if document.folder != "." else path,
        path=path,
        lens=_lens({**document.top, **frame}, sizes[path], where),
        world_from_camera=_pose(frame.get("transform_matrix"), document.opengl, where),
        **extra,
    )


def _image(root: Path, folder: str, file_path: str, where: str) -> str:
    """Blender's documents leave the extension away."""
    if PurePosixPath(file_path).suffix.lower() not in IMAGE_SUFFIXES:
        for suffix in (".png", ".jpg", ".jpeg", ".webp"):
            if "\0" not in file_path and (root / folder / f"{file_path}{suffix}").is_file():
                return inside(root, folder, f"{file_path}{suffix}", where)
    return inside(root, folder, file_path, where)


def _pose(matrix: Any, opengl: bool, where: str) -> NDArray[np.float64]:
    if matrix is None:
        raise InvalidInputError(
            f"{where} has no transform_matrix", field=where, hint="Give every frame a pose, or remove it."
        )
    rows_are_lists = isinstance(matrix, list) and all(isinstance(row, list) for row in matrix)
    if not rows_are_lists or not all(_is_number(value) for row in matrix for value in row):
        raise InvalidInputError(
            f"{where}: the transform_matrix is no 4×4 list of numbers", field=where, hint=_POSE_HINT
        )
    if len(matrix) not in (3, 4) or any(len(row) != 4 for row in matrix):
        raise InvalidInputError(f"{where}: the transform_matrix is not 4×4", field=where, hint=_POSE_HINT)
    pose = np.eye(4)
    pose[: len(matrix)] = matrix
    try:
        check_rigid(pose, field=where)
    except InvalidInputError as error:
        raise InvalidInputError(error.message, field=where, hint=error.hint or _POSE_HINT) from error
    if opengl:
        pose = pose @ _OPENCV_FROM_OPENGL
    # Files round to a few digits: take the nearest rotation, so that products of poses stay rigid.
    left, _, right = np.linalg.svd(pose[:3, :3])
    pose[:3, :3] = left @ right
    return pose


def _lens(values: Mapping[str, Any], size: tuple[int, int], where: str) -> Lens:
    """Per-frame keys win over the document's; see `GivenPhoto.lens` for the resolution."""
    given = {
        key: _number(values, key, where)
        for key in (
            "w",
            "h",
            "fl_x",
            "fl_y",
            "cx",
            "cy",
            "camera_angle_x",
            "camera_angle_y",
            *_FISHEYE_KEYS,
            "p1",
            "p2",
        )
        if values.get(key) is not None
    }
    width, height = (int(given["w"]), int(given["h"])) if "w" in given and "h" in given else size
    if width < 1 or height < 1:
        raise InvalidInputError(
            f"{where}: an image of {width}×{height} pixels", field=where, hint="Give w and h in pixels."
        )
    fx = given.get("fl_x") or _focal(given.get("camera_angle_x"), width)
    fy = given.get("fl_y") or _focal(given.get("camera_angle_y"), height) or fx
    if not fx or not fy:
        raise InvalidInputError(
            f"{where} has no focal length",
            field=where,
            hint="Give fl_x and fl_y in pixels, or camera_angle_x in radians.",
        )
    centre = (given.get("cx", width / 2), given.get("cy", height / 2))
    model = str(values.get("camera_model") or "").upper()
    if model == "OPENCV_FISHEYE":
        params = (fx, fy, *centre, *(given.get(key, 0.0) for key in _FISHEYE_KEYS))
    elif model in ("", *_PERSPECTIVES):
        bent = any(given.get(key) for key in ("k1", "k2", "k3", "k4", "p1", "p2"))
        if bent and model in _PINHOLES:
            raise InvalidInputError(
                f"{where}: a {model} camera with distortion", field=where, hint='Say "camera_model": "OPENCV".'
            )
        radial = [given.get(key, 0.0) for key in _OPENCV_KEYS]
        model = "PINHOLE"
        params = (fx, fy, *centre)
        if given.get("k3") or given.get("k4"):
            model, params = (
                "FULL_OPENCV",
                (fx, fy, *centre, *radial, given.get("k3", 0.0), given.get("k4", 0.0), 0.0, 0.0),
            )
        elif bent:
            model, params = "OPENCV", (fx, fy, *centre, *radial)
    else:
        raise InvalidInputError(
            f"{where}: the camera model {model[:40]!r} is unknown",
            field=where,
            hint=f"Use one of {', '.join((*_PERSPECTIVES, 'OPENCV_FISHEYE'))}.",
        )
    lens = Lens(model, width, height, params)
    check_lens(lens, field=where)
    return lens


def _focal(angle: float | None, pixels: int) -> float | None:
    return None if angle is None or not 0.0 < angle < math.pi else pixels / (2.0 * math.tan(angle / 2.0))


def _number(values: Mapping[str, Any], key: str, where: str) -> float:
    value = values[key]
    if not _is_number(value) or not math.isfinite(value):
        raise InvalidInputError(
            f"{where}: {key} is {str(value)[:40]}", field=where, hint=f"Make {key} a finite number."
        )
    return float(value)


def _is_number(value: Any) -> bool:
    return isinstance(value, float) or (type(value) is int and abs(value) < 10**18)


def _is_opengl(convention: Any, name: str) -> bool:
    text = str(convention).casefold()
    opengl = "opengl" in text or text in ("nerfstudio", "blender")
    if opengl == ("opencv" in text) or re.search(r"w2c|world.?to.?camera|camera.?from.?world", text):
        raise InvalidInputError(
            f"{name}: the convention {text[:60]!r} is unknown",
            field=f"{name}: convention",
            hint='Say "opengl" (y up, z backward, nerfstudio\'s own) or "opencv" (y down, z forward).',
        )
    return opengl


def _scale(top: Mapping[str, Any]) -> Scale:
    said = f"{top.get('scale', '')} {top.get('unit', '')} {top.get('units', '')} {top.get('convention', '')}"
    return "METRIC" if re.search(r"\b(metric|m|met(re|er)s?)\b", said, re.IGNORECASE) else "ARBITRARY"


def _points(
    root: Path, document: _Document, settings: CaptureSettings
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    named = document.top.get("ply_file_path")
    if named is None:
        beside = (root / document.folder / "points3d.ply").is_file()
        return _read(root, document, "points3d.ply", settings) if beside else no_points()
    if not isinstance(named, str):
        raise InvalidInputError(f"{document.name}: ply_file_path is no text", field=document.name, hint="Name a file.")
    return _read(root, document, named, settings)


def _read(
    root: Path, document: _Document, named: str, settings: CaptureSettings
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    path = inside(root, document.folder, named, f"{document.name}: ply_file_path")
    return read_points(root / path, path, settings)


def _test_names(document: _Document, names: list[str]) -> tuple[str, ...]:
    """From "split": {"test": [...]}, or nerfstudio's "test_filenames"; with or without folder and extension."""
    split = document.top.get("split")
    listed = split.get("test") if isinstance(split, dict) else document.top.get("test_filenames")
    if listed is None:
        return ()
    if not isinstance(listed, list) or not all(isinstance(item, str) for item in listed):
        raise InvalidInputError(
            f"{document.name}: the test split is no list of names",
            field=document.name,
            hint="Give a list of file names.",
        )
    by_key = {key: name for name in names for key in (name, PurePosixPath(name).name, PurePosixPath(name).stem)}
    unknown = [item for item in listed if item.removeprefix("./") not in by_key]
    if unknown:
        raise InvalidInputError(
            f"{document.name}: the test split names {unknown[0][:80]!r}, which no frame shows",
            field=document.name,
            hint="Name frames by their file_path.",
        )
    return tuple(sorted({by_key[item.removeprefix("./")] for item in listed}))
