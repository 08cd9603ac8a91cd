"""Handles the splat of an upload: read once during validation, then kept as plain arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from safetensors.numpy import load_file

from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.formats.bounded_json import read_json
from fastsplat.service.capture.formats.upload_manifest import UploadManifest
from fastsplat.service.capture.uploads.posed_input import PosedDataset, PosedImage, stated_similarity
from fastsplat.service.capture.uploads.splat_files.rows import SplatLimits, SplatRows
from fastsplat.service.capture.uploads.splat_files.splat_reading import (
    describe_invisible,
    describe_numbers,
    read_splat_file,
)
from fastsplat.service.capture.uploads.upload_kind import UploadContents
from fastsplat.service.common.array_files import write_arrays
from fastsplat.service.common.files import link_or_copy
from fastsplat_contract.errors import InvalidInputError

_SPLAT = "splat.safetensors"
_HINT = "Send dataparser_transforms.json as nerfstudio wrote it, beside the config of the run."


def check_splats(splats: Sequence[str]) -> None:
    """Raises `InvalidInputError` if an upload has more than one splat."""
    if len(splats) > 1:
        raise InvalidInputError(
            f"the upload has {len(splats)} splats, e.g. {splats[0]} and {splats[1]}",
            field=splats[1],
            hint="Send the splat that is to become the scene, and no other.",
        )


def admit_splat(
    files: Path, contents: UploadContents, manifest: UploadManifest, folder: Path, settings: CaptureSettings
) -> UploadManifest:
    """Adds the upload's splat to its manifest; moves its arrays to `folder`, removing its file.

    Raises:
        InvalidInputError, LimitExceededError: as `read_splat_file`; or the file of its frame cannot be read.
    """
    (name,) = contents.splats
    limits = SplatLimits(settings.max_splat_gaussians, "FASTSPLAT_CAPTURE__MAX_SPLAT_GAUSSIANS")
    file = read_splat_file(files / name, name, limits)
    if contents.splat_frame:
        _splat_from_poses(files, contents.splat_frame, contents.poses, settings)
    write_arrays(vars(file.rows), folder / _SPLAT)
    (files / name).unlink()
    return replace(
        manifest,
        splat=name,
        gaussians=len(file.rows),
        splat_frame=contents.splat_frame,
        warnings=(*manifest.warnings, *describe_invisible(name, file), *describe_numbers(name, file)),
    )


def take_splat(validated: Path, folder: Path) -> Path:
    """Links the arrays of a validated splat into a capture's folder."""
    target = folder / _SPLAT
    link_or_copy(validated / _SPLAT, target)
    return target


def load_splat(path: Path) -> SplatRows:
    """Loads the rows of `Capture.splat` in the order of the user's file."""
    return SplatRows(**load_file(path))


def in_splat_frame(
    dataset: PosedDataset, files: Path, manifest: UploadManifest, settings: CaptureSettings
) -> PosedDataset:
    """Moves poses and points to the splat's world: x' = scale · transform · x.

    Both are from nerfstudio's dataparser_transforms.json, which includes transforms.json's `applied_transform` and
    `applied_scale`.
    """
    matrix, scale = _splat_from_poses(files, manifest.splat_frame, manifest.poses, settings)
    return replace(
        dataset,
        images=tuple(_moved(image, matrix, scale) for image in dataset.images),
        points=((dataset.points @ matrix[:3, :3].T + matrix[:3, 3]) * scale).astype(np.float32),
        scale="ARBITRARY",
    )


def _moved(image: PosedImage, matrix: NDArray[np.float64], scale: float) -> PosedImage:
    pose = matrix @ image.world_from_camera
    pose[:3, 3] *= scale
    return replace(image, world_from_camera=pose)


def _splat_from_poses(
    files: Path, frame: str, poses: str, settings: CaptureSettings
) -> tuple[NDArray[np.float64], float]:
    """Reads a rigid transform [4, 4] and the scale applied after it."""
    matrix, scale = stated_similarity(read_json(files / frame, frame, settings), ("transform", "scale"), frame, _HINT)
    if not poses.endswith(".json"):
        return matrix, scale
    document = {
        "applied_transform": np.eye(4).tolist(),
        "applied_scale": 1.0,
        **read_json(files / poses, poses, settings),
    }
    applied, applied_scale = stated_similarity(document, ("applied_transform", "applied_scale"), poses, _HINT)
    return matrix @ np.linalg.inv(applied), scale / applied_scale
