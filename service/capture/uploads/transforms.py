"""Reads nerfstudio's transforms.json (https://docs.nerf.studio/quickstart/data_conventions.html)."""

from __future__ import annotations

import math
import posixpath
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.formats.bounded_json import read_json
from fastsplat.service.capture.formats.depth_files import ARRAY_SUFFIX, DepthFile, check_depth_unit
from fastsplat.service.capture.formats.depth_files import IMAGE_SUFFIXES as DEPTH_IMAGE_SUFFIXES
from fastsplat.service.capture.formats.image_io import IMAGE_SUFFIXES
from fastsplat.service.capture.formats.ply_points import read_points
from fastsplat.service.capture.photos.camera_model import CameraModel, check_camera_model
from fastsplat.service.capture.uploads.label_maps import LabelTable, parse_label_table
from fastsplat.service.capture.uploads.left_out import LeftOut
from fastsplat.service.capture.uploads.named_files import NamedFiles
from fastsplat.service.capture.uploads.photo_validation import too_many_images
from fastsplat.service.capture.uploads.posed_input import (
    MissingImage,
    PosedDataset,
    PosedImage,
    check_position,
    missing_warning,
    no_points,
    stated_similarity,
)
from fastsplat.service.common.similarity import nearest_rotation
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.geometry.camera import OPENCV_FROM_OPENGL, check_rigid
from fastsplat_contract.messages.scenes import Scale

_POSE_HINT = "Give a rigid 4×4 world-from-camera matrix of finite numbers, or remove the frame."
_SIZE_KEYS = ("w", "h")
_FOCAL_KEYS = ("fl_x", "fl_y", "cx", "cy", "camera_angle_x", "camera_angle_y")
_OPENCV_KEYS = ("k1", "k2", "p1", "p2")
_FISHEYE_KEYS = ("k1", "k2", "k3", "k4")
_DISTORTION_KEYS = (*_FISHEYE_KEYS, "p1", "p2")
_CIRCLE_KEY = "fisheye_crop_radius"
_PINHOLES = ("PINHOLE", "SIMPLE_PINHOLE")
_PERSPECTIVES = ("OPENCV", "FULL_OPENCV", "RADIAL", "SIMPLE_RADIAL", *_PINHOLES)
_MILLIMETER = 0.001
_MAX_PATH_LETTERS = 1_024
_CAMERA_KEYS = (*_SIZE_KEYS, *_FOCAL_KEYS, *_DISTORTION_KEYS, _CIRCLE_KEY, "camera_model")
_SAME_FOCAL = (("fl_x", "camera_angle_x"), ("fl_y", "camera_angle_y"))
BLENDER_DOCUMENTS = ("transforms_train.json", "transforms_val.json", "transforms_test.json")
_IMPLIED_SUFFIXES = (".png", ".jpg", ".jpeg", ".webp")


@dataclass(frozen=True)
class _Document:
    folder: str
    name: str
    top: Mapping[str, Any]
    opengl: bool
    labels: LabelTable | None
    depth_unit: float
    files: NamedFiles


def read_transforms(
    root: Path, name: str, sizes: Mapping[str, tuple[int, int]], settings: CaptureSettings, left_out: LeftOut
) -> PosedDataset:
    """Reads cameras, poses, points and label maps of a transforms.json.

    Poses are world-from-camera in OpenGL axes (x right, y up, z backward) unless "convention" says "opencv". A frame's
    "mask_path" is its label map if the document has "labels", else nerfstudio's mask, ignoring pixels that are zero.
    Frames without an image are skipped with a warning, as in nerfstudio.

    Args:
        name: path of the document relative to `root`.
        sizes: (width, height) of the images as stored, by path, if the document lacks "w" and "h".
        left_out: receives frames with a missing, singular, scaled, non-finite or far pose, no focal length or mask, an
            unknown camera model, or an impossible name.

    Raises:
        InvalidInputError: no frame is left, an unknown convention, an `applied_transform` that is not rigid, fewer
            images than `min_frames_present`.
        LimitExceededError: the document or its points are larger than the settings allow.
    """
    top = _whole_document(root, name, settings)
    frames = top["frames"]
    if len(frames) > settings.max_images:
        raise too_many_images(len(frames), settings)
    labels = parse_label_table(top["labels"], field=f"{name}: labels") if "labels" in top else None
    files = NamedFiles(root, name)
    opengl = _is_opengl(top.get("convention", "opengl"), name)
    if top.get("applied_transform") is not None:  # already in the poses, so it is only checked
        stated = {"applied_scale": 1.0, **top}
        stated_similarity(stated, ("applied_transform", "applied_scale"), name, "Write it as nerfstudio does, or not.")
    unit = _MILLIMETER
    if any(isinstance(frame, dict) and frame.get("depth_file_path") is not None for frame in frames):
        unit = check_depth_unit(top.get("depth_unit_scale_factor", unit), field=f"{name}: depth_unit_scale_factor")
    document = _Document(PurePosixPath(name).parent.as_posix(), name, top, opengl, labels, unit, files)
    images, missing, name_by_asked = _frames(document, frames, sizes, left_out)
    warnings = (*missing_warning(name, missing, len(frames), settings), *files.warnings())
    if not images:
        raise left_out.refusal(InvalidInputError(f"{name} has no frame", field=name, hint="Give each image one frame."))
    points, colors = _points(root, document, settings)
    return PosedDataset(
        images=images,
        points=points,
        point_colors=colors,
        scale=_scale(top),
        labels=labels,
        test_names=_test_names(document, [image.name for image in images], name_by_asked),
        missing=missing,
        warnings=warnings,
    )


def _whole_document(root: Path, name: str, settings: CaptureSettings) -> dict[str, Any]:
    """Reads a document without null values; merges Blender's training, validation and test documents."""
    parts = BLENDER_DOCUMENTS if PurePosixPath(name).name in BLENDER_DOCUMENTS else (PurePosixPath(name).name,)
    whole: dict[str, Any] = {}
    for path in (PurePosixPath(name).with_name(part) for part in parts):
        if not (root / path).is_file():
            continue
        top = read_json(root / path, str(path), settings)
        frames = top.get("frames") if isinstance(top, dict) else None
        if not isinstance(frames, list) or not frames:
            raise InvalidInputError(f"{path} has no list of frames", field=str(path), hint="Give each image one frame.")
        top = {key: value for key, value in top.items() if value is not None}
        frames = [_with_camera(top, frame) if isinstance(frame, dict) else frame for frame in frames]
        if path.name == BLENDER_DOCUMENTS[-1]:
            top["split"] = {"test": [frame.get("file_path") for frame in frames if isinstance(frame, dict)]}
        whole = {**top, **whole, "frames": [*whole.get("frames", ()), *frames]}
    return whole


def _with_camera(top: Mapping[str, Any], frame: Mapping[str, Any]) -> dict[str, Any]:
    """Completes a frame's camera by its document's, in either notation."""
    values = {key: value for key, value in frame.items() if value is not None}
    focal_keys = {key for pair in _SAME_FOCAL for key in pair if values.keys() & set(pair)}
    return {key: top[key] for key in _CAMERA_KEYS if key in top and key not in focal_keys} | values


def name_keys(name: str) -> tuple[str, str, str]:
    """Names of an image in a split: with its folder, without, and without its extension."""
    return name, PurePosixPath(name).name, PurePosixPath(name).stem


def _frames(
    document: _Document, frames: Sequence[Any], sizes: Mapping[str, tuple[int, int]], left_out: LeftOut
) -> tuple[tuple[PosedImage, ...], tuple[MissingImage, ...], dict[str, str]]:
    """Reads frames: sorted images, missing ones, and view names ("" if missing) by file_path."""
    images: dict[str, PosedImage] = {}
    missing, name_by_asked = [], dict[str, str]()
    paths = [str(frame.get("file_path")) for frame in frames if isinstance(frame, dict)]
    document.files.expect(document.folder, (path + end for path in paths for end in ("", *_IMPLIED_SUFFIXES)))
    for index, frame in enumerate(frames):
        where, key = f"{document.name}: frame {index}", f"frame {index} of {document.name}"
        file_path = frame.get("file_path") if isinstance(frame, dict) else None
        if isinstance(file_path, str) and 0 < len(file_path) <= _MAX_PATH_LETTERS:
            where = f"{where} ({file_path[:120]})"
            path = posixpath.normpath(posixpath.join(document.folder, file_path))
            key = key if path in images else path
            name_by_asked.setdefault(file_path.removeprefix("./"), "")
        with left_out.costs(key, where):
            result = _posed_image(document, frame, sizes, where)
            if isinstance(result, MissingImage):
                missing.append(result)
                continue
            if result.path in images:
                raise InvalidInputError.of(where, "shows the same file as another frame", "Give each image one frame.")
            images[result.path] = result
            name_by_asked[frame["file_path"].removeprefix("./")] = result.name
    ordered = tuple(sorted(images.values(), key=lambda image: image.name))
    return ordered, tuple(missing), name_by_asked


def _posed_image(
    document: _Document, frame: Any, sizes: Mapping[str, tuple[int, int]], where: str
) -> PosedImage | MissingImage:
    file_path = frame.get("file_path") if isinstance(frame, dict) else None
    if not isinstance(file_path, str) or not file_path:
        raise InvalidInputError(f"{where} has no file_path", field=where, hint="Name the frame's image.")
    if len(file_path) > _MAX_PATH_LETTERS:
        raise InvalidInputError.of(
            where,
            f"has a file_path of {len(file_path)} characters",
            "Name the frame's image.",
            f"{_MAX_PATH_LETTERS} characters",
        )
    # Blender's documents omit the extension.
    suffixes = () if PurePosixPath(file_path).suffix.lower() in IMAGE_SUFFIXES else _IMPLIED_SUFFIXES
    path = document.files.path(document.folder, file_path, where, photo=True, suffixes=suffixes)
    name = posixpath.relpath(path, document.folder)
    if not document.files.has(path):
        return MissingImage(name, path)
    if path not in sizes:
        raise InvalidInputError.of(where, "is not an image", "Send JPEG, PNG, WebP, TIFF, BMP or HEIC images.")
    maps = {}
    mask = frame.get("mask_path")
    if mask is not None:
        if not isinstance(mask, str):
            raise InvalidInputError(f"{where} has a mask_path that is not text", field=where, hint="Name a file.")
        key = "mask" if document.labels is None else "label_map"
        maps[key] = document.files.file(document.folder, mask, where)
    return PosedImage(
        name=name,
        path=path,
        camera_model=_camera_model(frame, sizes[path], where),
        world_from_camera=_pose(frame.get("transform_matrix"), document.opengl, where),
        depth=_depth_file(document, frame, where),
        **maps,
    )


def _depth_file(document: _Document, frame: Mapping[str, Any], where: str) -> DepthFile | None:
    """Reads a frame's depth map (docs.nerf.studio, "Depth images"), by default in millimeters."""
    name = frame.get("depth_file_path")
    if name is None:
        return None
    if not isinstance(name, str):
        raise InvalidInputError(f"{where} has a depth_file_path that is not text", field=where, hint="Name a file.")
    suffix = PurePosixPath(name).suffix.lower()
    if suffix not in {*DEPTH_IMAGE_SUFFIXES, ARRAY_SUFFIX}:
        raise InvalidInputError.of(
            where,
            f": depth maps of the kind {suffix[:20]!r} are not read",
            "Send 16-bit PNG files, millimeters, or float arrays as .npy.",
        )
    path = document.files.path(document.folder, name, where)
    if not document.files.has(path):
        raise InvalidInputError.of(
            where,
            f"names the depth map {name[:120]!r}, which is not in the upload",
            "Send the depth maps under the names that depth_file_path gives them, or leave that key away.",
        )
    return DepthFile(path, document.depth_unit)


def _pose(matrix: Any, opengl: bool, where: str) -> NDArray[np.float64]:
    if matrix is None:
        raise InvalidInputError.of(where, "has no transform_matrix", "Give every frame a pose, or remove it.")
    rows_are_lists = isinstance(matrix, list) and all(isinstance(row, list) for row in matrix)
    if not rows_are_lists or not all(_is_number(value) for row in matrix for value in row):
        raise InvalidInputError.of(where, ": the transform_matrix is not a 4×4 list of numbers", _POSE_HINT)
    if len(matrix) not in (3, 4) or any(len(row) != 4 for row in matrix):
        raise InvalidInputError(f"{where}: the transform_matrix is not 4×4", field=where, hint=_POSE_HINT)
    pose = np.eye(4)
    pose[: len(matrix)] = matrix
    try:
        check_rigid(pose, field=where)
        check_position(pose, where)
    except InvalidInputError as error:
        raise InvalidInputError(error.message, field=where, hint=error.hint or _POSE_HINT) from error
    if opengl:
        pose = pose @ OPENCV_FROM_OPENGL
    pose[:3, :3] = nearest_rotation(pose[:3, :3])  # so that products of poses stay rigid
    return pose


def _camera_model(values: Mapping[str, Any], size: tuple[int, int], where: str) -> CameraModel:
    """Reads the camera of a frame with its document's defaults."""
    numbers = {key: _number(values, key, where) for key in _CAMERA_KEYS[:-1] if key in values}
    width, height = (int(numbers["w"]), int(numbers["h"])) if "w" in numbers and "h" in numbers else size
    if width < 1 or height < 1:
        raise InvalidInputError.of(where, f": an image of {width}×{height} pixels", "Give w and h in pixels.")
    fx = numbers.get("fl_x") or _focal(numbers.get("camera_angle_x"), width)
    fy = numbers.get("fl_y") or _focal(numbers.get("camera_angle_y"), height) or fx
    if not fx or not fy:
        raise InvalidInputError.of(
            where, "has no focal length", "Give fl_x and fl_y in pixels, or camera_angle_x in radians."
        )
    pinhole = (fx, fy, numbers.get("cx", width / 2), numbers.get("cy", height / 2))
    model, distortion = _distortion(str(values.get("camera_model") or "").upper(), numbers, where)
    circle_px = numbers.get(_CIRCLE_KEY) if model == "OPENCV_FISHEYE" else None
    camera_model = CameraModel(model, width, height, (*pinhole, *distortion), circle_px)
    check_camera_model(camera_model, field=where)
    return camera_model


def _distortion(stated: str, numbers: Mapping[str, float], where: str) -> tuple[str, tuple[float, ...]]:
    """Chooses COLMAP's simplest model for the distortion, and its distortion parameters."""

    def parameters(keys: Iterable[str]) -> tuple[float, ...]:
        return tuple(numbers.get(key, 0.0) for key in keys)

    if stated == "OPENCV_FISHEYE":
        return stated, parameters(_FISHEYE_KEYS)
    if stated not in ("", *_PERSPECTIVES):
        raise InvalidInputError.of(
            where,
            f": the camera model {stated[:40]!r} is unknown",
            f"Use one of {', '.join((*_PERSPECTIVES, 'OPENCV_FISHEYE'))}.",
        )
    if not any(parameters(_DISTORTION_KEYS)):
        return "PINHOLE", ()
    if stated in _PINHOLES:
        raise InvalidInputError.of(where, f": a {stated} camera with distortion", 'Say "camera_model": "OPENCV".')
    if any(parameters(("k3", "k4"))):
        return "FULL_OPENCV", (*parameters((*_OPENCV_KEYS, "k3", "k4")), 0.0, 0.0)
    return "OPENCV", parameters(_OPENCV_KEYS)


def _focal(angle: float | None, pixels: int) -> float | None:
    return None if angle is None or not 0.0 < angle < math.pi else pixels / (2.0 * math.tan(angle / 2.0))


def _number(values: Mapping[str, Any], key: str, where: str) -> float:
    value = values[key]
    if not _is_number(value) or not math.isfinite(value):
        raise InvalidInputError(f"{where}: {key} is {value!r:.40}", field=where, hint=f"Make {key} a finite number.")
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
    text = f"{top.get('scale', '')} {top.get('unit', '')} {top.get('units', '')} {top.get('convention', '')}"
    return "METRIC" if re.search(r"\b(metric|m|met(re|er)s?)\b", text, re.IGNORECASE) else "ARBITRARY"


def _points(
    root: Path, document: _Document, settings: CaptureSettings
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    name = document.top.get("ply_file_path")
    if name is None:
        if not (root / document.folder / "points3d.ply").is_file():
            return no_points()
        name = "points3d.ply"
    if not isinstance(name, str):
        raise InvalidInputError(f"{document.name}: ply_file_path is not text", field=document.name, hint="Name a file.")
    path = document.files.file(document.folder, name, f"{document.name}: ply_file_path")
    return read_points(root / path, path, settings)


def _test_names(document: _Document, names: list[str], name_by_asked: Mapping[str, str]) -> tuple[str, ...]:
    """Reads "split": {"test": [...]}, or nerfstudio's "test_filenames", without unused frames."""
    split = document.top.get("split")
    entries = split.get("test") if isinstance(split, dict) else document.top.get("test_filenames")
    if entries is None:
        return ()
    if not isinstance(entries, list) or not all(isinstance(entry, str) for entry in entries):
        raise InvalidInputError.of(
            document.name, ": the test split is not a list of names", "Give a list of file names."
        )
    name_by_key = {key: name for path, name in name_by_asked.items() for key in name_keys(path)}
    name_by_key |= {key: name for name in names for key in name_keys(name)}
    name_by_key |= {path: name for path, name in name_by_asked.items() if name or path not in name_by_key}
    test_names = set()
    for entry in entries:
        key = entry.removeprefix("./")
        if key in name_by_key:
            test_names.add(name_by_key[key])
        else:
            raise InvalidInputError.of(
                document.name,
                f": the test split names {entry[:80]!r}, which no frame shows",
                "Name frames by their file_path.",
            )
    return tuple(sorted(test_names - {""}))
