"""Reads COLMAP models (https://colmap.github.io/format.html) with every read bounded and number checked."""

from __future__ import annotations

import posixpath
import struct
from collections.abc import Iterator, Mapping
from itertools import islice
from pathlib import Path
from typing import BinaryIO, NoReturn

import numpy as np
import pycolmap

from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.formats.ply_points import too_many_points
from fastsplat.service.capture.photos.camera_model import CameraModel, check_camera_model, model_names, parameter_count
from fastsplat.service.capture.uploads.left_out import LeftOut
from fastsplat.service.capture.uploads.named_files import NamedFiles
from fastsplat.service.capture.uploads.photo_validation import too_many_images
from fastsplat.service.capture.uploads.posed_input import PosedDataset, PosedImage, check_position
from fastsplat_contract.errors import InvalidInputError
from fastsplat_contract.geometry.camera import check_rigid

_MAX_NAME_BYTES = 1_024
_HINT = "Export the model again."
_POINT_HEAD = struct.Struct("<Q3d3BdQ")

_Pose = tuple[str, int, tuple[float, ...]]  # image name, camera id, qw qx qy qz tx ty tz
_Point = tuple[tuple[float, ...], tuple[int, ...], float]  # position, color, error in pixels


def model_suffix(folder: Path) -> str | None:
    """Detects a model: ".bin" (preferred) or ".txt"; None without one."""
    for suffix in (".bin", ".txt"):
        if all((folder / f"{part}{suffix}").is_file() for part in ("cameras", "images")):
            return suffix
    return None


def count_images(folder: Path) -> int:
    """Estimates a model's number of images, to choose between models, by claimed counts and sizes."""
    path = folder / f"images{model_suffix(folder)}"
    with path.open("rb") as file:
        if path.suffix == ".bin":
            return min(int.from_bytes(file.read(8), "little"), path.stat().st_size // _IMAGE_HEAD.size)
        return sum(line.split()[9:] != [] and not _are_observations(line.decode(errors="replace")) for line in file)


def read_colmap(root: Path, model: str, images: str, settings: CaptureSettings, left_out: LeftOut) -> PosedDataset:
    """Reads cameras, poses and points of a COLMAP model; points3D may be missing.

    Args:
        model, images: folders of the model and of its images, relative to `root`.
        left_out: receives images with an invalid camera or pose, and missing ones.

    Raises:
        InvalidInputError: cut short, an invalid point, or no image is left. The message names the file.
        LimitExceededError: more images or points than the settings allow.
    """
    folder = root / model
    suffix = model_suffix(folder)
    assert suffix is not None
    name = {part: f"{model}/{part}{suffix}".removeprefix("./") for part in ("cameras", "images", "points3D")}
    binary = suffix == ".bin"
    cameras_path, images_path, points_path = (folder / f"{part}{suffix}" for part in name)
    camera_models = dict((_binary_cameras if binary else _text_cameras)(cameras_path, name["cameras"]))
    posed_images, names = list[PosedImage](), NamedFiles(root, name["images"])
    poses = list(
        islice((_binary_images if binary else _text_images)(images_path, name["images"]), settings.max_images + 1)
    )
    if len(poses) > settings.max_images:
        raise too_many_images(len(poses), settings)
    names.expect(images, (pose[0] for pose in poses))
    for pose in poses:
        with left_out.costs(posixpath.normpath(posixpath.join(images, pose[0])), f"{name['images']}: {pose[0]}"):
            posed_images.append(_posed_image(names, images, pose, camera_models, name))
    if not posed_images:
        problem = InvalidInputError(f"{name['images']}: no image has a pose", field=name["images"], hint=_HINT)
        raise left_out.refusal(problem)
    names_and_paths = [(image.name, image.path) for image in posed_images]
    if any(len(set(column)) < len(column) for column in zip(*names_and_paths, strict=True)):
        raise InvalidInputError(f"{name['images']}: two images share a name", field=name["images"], hint=_HINT)
    positions: list[tuple[float, ...]] = []
    colors: list[tuple[int, ...]] = []
    errors: list[float] = []
    if points_path.is_file():
        for position, color, error in (_binary_points if binary else _text_points)(points_path, name["points3D"]):
            if len(positions) >= settings.max_model_points:
                raise too_many_points(name["points3D"], len(positions) + 1, settings)
            positions.append(position)
            colors.append(color)
            errors.append(error)
    points = np.array(positions, dtype=np.float32).reshape(-1, 3)
    if not np.isfinite(points).all():
        raise InvalidInputError(f"{name['points3D']} has NaN or infinite positions", field=name["points3D"], hint=_HINT)
    known_errors = [error for error in errors if np.isfinite(error) and error >= 0]
    return PosedDataset(
        images=tuple(sorted(posed_images, key=lambda image: image.name)),
        points=points,
        point_colors=np.array(colors, dtype=np.uint8).reshape(-1, 3),
        mean_reprojection_error_px=float(np.mean(known_errors)) if known_errors else 0.0,
        warnings=names.warnings(),
    )


def _posed_image(
    files: NamedFiles, images: str, pose: _Pose, camera_models: dict[int, CameraModel], names: Mapping[str, str]
) -> PosedImage:
    image_name, camera_id, numbers = pose
    field = names["images"]
    where = f"{field}: {image_name}"
    if camera_id not in camera_models:
        raise InvalidInputError(f"{where} uses camera {camera_id}, which does not exist", field=field, hint=_HINT)
    check_camera_model(camera_models[camera_id], field=f"{names['cameras']}: camera {camera_id}")
    if not np.isfinite(numbers).all():
        raise InvalidInputError(f"{where} has NaN or infinite numbers in its pose", field=field, hint=_HINT)
    length = float(np.linalg.norm(numbers[:4]))
    if abs(length - 1.0) > 1e-2:
        raise InvalidInputError(f"{where} has a quaternion of length {length:.4g}, expected 1", field=field, hint=_HINT)
    world_from_camera = np.eye(4)
    w, x, y, z = np.array(numbers[:4]) / length
    world_from_camera[:3, :3] = pycolmap.Rotation3d(np.array([x, y, z, w])).inverse().matrix()
    world_from_camera[:3, 3] = -world_from_camera[:3, :3] @ numbers[4:]
    check_rigid(world_from_camera, field=where)
    check_position(world_from_camera, where)
    path = files.file(images, image_name, field, photo=True)
    subpath = posixpath.relpath(path, images)
    masks = (f"{folder}/{subpath}.png" for folder in ("masks", "mask"))  # COLMAP's own layout, beside the images
    beside = (posixpath.normpath(posixpath.join(images, up, mask)) for mask in masks for up in ("..", "."))
    mask = next((mask for mask in beside if not mask.startswith("..") and files.has(mask)), None)
    return PosedImage(image_name, path, camera_models[camera_id], world_from_camera, mask=mask)


class _Binary:
    """Reads a binary file, never beyond its end."""

    def __init__(self, file: BinaryIO, size: int, field: str) -> None:
        self._file, self._left, self._field = file, size, field

    def take(self, form: struct.Struct) -> tuple[float, ...]:
        return form.unpack(self._read(form.size))

    def count(self, least_bytes: int) -> int:
        """Reads a count of entries of at least `least_bytes` each."""
        (number,) = _U64.unpack(self._read(8))
        if number * least_bytes > self._left:
            self.fail(f"claims {number} entries, but is too short for them")
        return int(number)

    def skip(self, size: int) -> None:
        if size > self._left:
            self.fail("is cut short")
        self._file.seek(size, 1)
        self._left -= size

    def name(self) -> str:
        letters = bytearray()
        while (letter := self._read(1)) != b"\0":
            letters += letter
            if len(letters) > _MAX_NAME_BYTES:
                self.fail(f"has an image name longer than {_MAX_NAME_BYTES} bytes")
        try:
            return letters.decode()
        except UnicodeDecodeError:
            self.fail("has an image name that is not UTF-8")

    def fail(self, problem: str) -> NoReturn:
        raise InvalidInputError(f"{self._field} {problem}", field=self._field, hint=_HINT)

    def _read(self, size: int) -> bytes:
        data = self._file.read(size) if size <= self._left else b""
        if len(data) < size:
            self.fail("is cut short")
        self._left -= size
        return data


_U64 = struct.Struct("<Q")
_CAMERA_HEAD = struct.Struct("<IiQQ")
_IMAGE_HEAD = struct.Struct("<I7dI")


def _binary_cameras(path: Path, field: str) -> Iterator[tuple[int, CameraModel]]:
    with path.open("rb") as file:
        reader = _Binary(file, path.stat().st_size, field)
        for _ in range(reader.count(_CAMERA_HEAD.size)):
            camera_id, model_id, width, height = (int(value) for value in reader.take(_CAMERA_HEAD))
            model = model_names().get(model_id)
            if model is None:
                reader.fail(f"has a camera of the model {model_id}, which is unknown or spherical")
            params = reader.take(struct.Struct(f"<{parameter_count(model)}d"))
            yield camera_id, CameraModel(model, width, height, params)


def _binary_images(path: Path, field: str) -> Iterator[_Pose]:
    with path.open("rb") as file:
        reader = _Binary(file, path.stat().st_size, field)
        for _ in range(reader.count(_IMAGE_HEAD.size + 9)):
            head = reader.take(_IMAGE_HEAD)
            name = reader.name()
            reader.skip(24 * reader.count(24))
            yield name, int(head[8]), head[1:8]


def _binary_points(path: Path, field: str) -> Iterator[_Point]:
    with path.open("rb") as file:
        reader = _Binary(file, path.stat().st_size, field)
        for _ in range(reader.count(_POINT_HEAD.size)):
            head = reader.take(_POINT_HEAD)
            track = int(head[8])
            reader.skip(8 * track)
            yield head[1:4], tuple(int(value) for value in head[4:7]), head[7]


def _lines(path: Path, field: str) -> Iterator[str]:
    """Yields stripped lines; comments are empty."""
    try:
        with path.open(encoding="utf-8-sig") as file:
            for line in file:
                yield "" if line.startswith("#") else line.strip()
    except UnicodeDecodeError as error:
        raise InvalidInputError(f"{field} is not text", field=field, hint=_HINT) from error


def _text_cameras(path: Path, field: str) -> Iterator[tuple[int, CameraModel]]:
    for line in filter(None, _lines(path, field)):
        words = line.split()
        try:
            sizes = [float(word) for word in words[2:4]]  # some programs write 480.0
            width, height = (int(size) for size in sizes if size.is_integer())
            yield int(words[0]), CameraModel(words[1], width, height, tuple(map(float, words[4:])))
        except (ValueError, IndexError) as error:
            raise _bad_line(field, line) from error


def _text_images(path: Path, field: str) -> Iterator[_Pose]:
    after_image = False
    for line in _lines(path, field):
        # Each image is followed by a line of observations, which may be empty; some programs omit it.
        if (after_image and _are_observations(line)) or not line:
            after_image = False
            continue
        words = line.split(maxsplit=9)
        try:
            yield words[9], int(words[8]), tuple(map(float, words[1:8]))
        except (ValueError, IndexError) as error:
            raise _bad_line(field, line) from error
        after_image = True


def _are_observations(line: str) -> bool:
    """Detects triples of numbers; of an image's line, the tenth word is text."""
    words = line.split()
    try:
        return len(words) % 3 == 0 and [float(word) for word in words[:12]] != []
    except ValueError:
        return False


def _text_points(path: Path, field: str) -> Iterator[_Point]:
    for line in filter(None, _lines(path, field)):
        words = line.split(maxsplit=8)
        try:
            color = tuple(int(word) for word in words[4:7])
            if len(words) < 8 or not all(0 <= value <= 255 for value in color):
                raise ValueError
            yield tuple(map(float, words[1:4])), color, float(words[7])
        except ValueError as error:
            raise _bad_line(field, line) from error


def _bad_line(field: str, line: str) -> InvalidInputError:
    return InvalidInputError(f"{field} has the line {line[:80]!r}", field=field, hint=_HINT)
