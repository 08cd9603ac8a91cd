"""Which photos are placed, by whom, and what is measured of each: photos, points, error, seconds, pose error."""

from __future__ import annotations

import json
import resource
import shutil
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
from numpy.typing import NDArray

from fastsplat.service.capture.build import build_capture
from fastsplat.service.capture.settings import CaptureSettings
from fastsplat.service.capture.uploads.upload_validation import validate_upload
from fastsplat.service.common.progress import silent
from fastsplat.service.common.similarity import fit_similarity
from fastsplat_contract.errors import ReconstructionError

_SEED = 0
pycolmap.logging.minloglevel = 2
_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


@dataclass(frozen=True)
class Case:
    """Every `step`-th photo of a set."""

    name: str
    step: int

    def photos(self, data: Path) -> list[Path]:
        """The files, sorted by name."""
        return sorted((data / self.name / "images").iterdir())[:: self.step]


@dataclass(frozen=True)
class Placed:
    """What a method made of a case.

    Attributes:
        poses: world_from_camera [4, 4] by file name.
        points: how many.
        error_px: mean reprojection error.
        models: sizes of the separate models, largest first.
        warnings: of the service.
    """

    poses: Mapping[str, NDArray[np.float64]]
    points: int
    error_px: float
    models: tuple[int, ...]
    warnings: tuple[str, ...] = ()


def measure(case: Case, method: str, data: Path) -> dict[str, Any]:
    """One row of the table: `case` by `method` ("colmap", "fastsplat"), in this process and its children."""
    photos = case.photos(data)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "images").mkdir()
        for photo in photos:
            shutil.copy(photo, folder / "images")
        numbers = _measured(folder, METHODS[method], _truth(data / case.name))
    names = numbers.pop("names")
    left = [photo.name for photo in photos if photo.name not in names]
    return {**asdict(case), "method": method, "photos": len(photos), **numbers, "not_placed": left}


def measure_service(
    folder: Path, truth: Mapping[str, NDArray[np.float64]], settings: CaptureSettings
) -> dict[str, Any]:
    """The same of the photos in folder/images with their true poses, by the service with these settings."""
    numbers = _measured(folder, lambda photos: _by_service(photos, settings), truth)
    del numbers["names"]
    return numbers


def _measured(
    folder: Path, method: Callable[[Path], Placed], truth: Mapping[str, NDArray[np.float64]]
) -> dict[str, Any]:
    cpu, wall = _cpu_seconds(), time.monotonic()
    try:
        placed = method(folder)
    except ReconstructionError as error:
        placed = Placed({}, 0, 0.0, (), (str(error),))
    row = {
        "placed": len(placed.poses),
        "points": placed.points,
        "error_px": round(placed.error_px, 3),
        "models": list(placed.models),
        "cpu_s": round(_cpu_seconds() - cpu, 1),
        "wall_s": round(time.monotonic() - wall, 1),
        "peak_mb": round(max(_peak_mb(resource.RUSAGE_SELF), _peak_mb(resource.RUSAGE_CHILDREN))),
        "warnings": list(placed.warnings),
        "names": set(placed.poses),
    }
    if truth and len(placed.poses) > 2:
        row["pose_error"] = pose_error(placed.poses, truth)
    return row


def pose_error(poses: Mapping[str, NDArray[np.float64]], truth: Mapping[str, NDArray[np.float64]]) -> dict[str, float]:
    """Errors after the best similarity of the centers: of centers as a share of how far the true ones are spread, of
    rotations in degrees."""
    names = sorted(poses)
    a, b = (np.array([some[name] for name in names]) for some in (poses, truth))
    near, far = a[:, :3, 3], b[:, :3, 3]
    fit = fit_similarity(near, far)
    centers = np.linalg.norm(fit.points(near) - far, axis=1) / np.linalg.norm(np.ptp(far, axis=0))
    turns = np.einsum("nij,nik->njk", fit.rotation @ a[:, :3, :3], b[:, :3, :3])
    angles = np.degrees(np.arccos(np.clip((np.trace(turns, axis1=1, axis2=2) - 1) / 2, -1, 1)))
    return {
        "center_median": round(float(np.median(centers)), 5),
        "center_max": round(float(centers.max()), 5),
        "degrees_median": round(float(np.median(angles)), 3),
        "degrees_max": round(float(angles.max()), 3),
    }


def _truth(folder: Path) -> dict[str, NDArray[np.float64]]:
    path = folder / "transforms.json"
    if not path.exists():
        return {}
    frames = json.loads(path.read_text())["frames"]
    return {Path(frame["file_path"]).name: np.array(frame["transform_matrix"]) @ _OPENGL for frame in frames}


def _by_colmap(folder: Path) -> Placed:
    """COLMAP's defaults: 8,192 features, every pair, the incremental mapper."""
    database, images, output = folder / "colmap.db", folder / "images", folder / "models"
    output.mkdir()
    pycolmap.set_random_seed(_SEED)
    pycolmap.extract_features(database, images, device=pycolmap.Device.cpu)
    pycolmap.match_exhaustive(database, device=pycolmap.Device.cpu)
    options = pycolmap.IncrementalPipelineOptions()
    options.random_seed = _SEED
    models = pycolmap.incremental_mapping(database, images, output, options=options)
    ordered = sorted(models.values(), key=lambda model: -model.num_reg_images())
    if not ordered:
        return Placed({}, 0, 0.0, ())
    poses = {}
    for image in ordered[0].images.values():
        if image.has_pose:
            poses[image.name] = np.eye(4)
            poses[image.name][:3] = image.cam_from_world().inverse().matrix()
    sizes = tuple(model.num_reg_images() for model in ordered)
    return Placed(poses, ordered[0].num_points3D(), ordered[0].compute_mean_reprojection_error(), sizes)


def _by_service(folder: Path, settings: CaptureSettings | None = None) -> Placed:
    """What an upload of the photos becomes, with all that the service does to them."""
    settings = settings or CaptureSettings()
    validate_upload(folder, settings)
    capture = build_capture(folder, folder / "capture", settings, silent)
    return Placed(
        {Path(view.posed.name).name: view.posed.world_from_camera for view in capture.views},
        len(capture.points),
        capture.report.mean_reprojection_error_px,
        capture.report.models,
        capture.report.warnings,
    )


METHODS: Mapping[str, Callable[[Path], Placed]] = {"colmap": _by_colmap, "fastsplat": _by_service}


def _cpu_seconds() -> float:
    usages = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)


def _peak_mb(who: int) -> float:
    return resource.getrusage(who).ru_maxrss / 1024
