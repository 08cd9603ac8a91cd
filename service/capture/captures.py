"""The data types of a capture: views, points, labels and the report."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.common.dictionary import Dictionary
from fastsplat.service.common.radial_lens import RadialLens
from fastsplat.service.common.withheld import WithheldReport as WithheldReport
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from fastsplat_contract.messages.scenes import Scale, VerticalSource
from fastsplat_contract.photos.photo_verdicts import PhotoVerdict

Source = Literal["images", "video", "colmap", "nerfstudio", "splat", "polycam", "record3d", "arkit"]


@dataclass(frozen=True)
class ValidatedUpload:
    """An upload that was checked and unpacked; input of `build_capture`."""

    folder: Path  # inside the raw upload's folder
    source: Source
    images: int  # 0 for a video, whose frames are chosen later
    has_labels: bool = False  # brings label maps, so no detector runs
    warnings: tuple[str, ...] = ()  # sentences for people about what will not be used
    gaussians: int = 0  # of its splat
    left_out: Mapping[str, str] = field(default_factory=dict)  # reasons by names of unused files and frames


@dataclass(frozen=True)
class SensorDepth:
    """A view's depth map from a sensor: camera z in a 16-bit gray PNG."""

    path: Path  # in the capture's folder; 0 where nothing was measured
    camera: Camera  # intrinsics of the map's own pixels; its pose is the view's
    unit: float  # scene units of one step


@dataclass(frozen=True)
class View:
    """A registered image: upright, undistorted, RGB, of exactly the camera's size."""

    posed: PosedCamera  # with the image's name in the upload
    image_path: Path  # PNG or JPEG in the capture's folder
    valid_path: Path | None = None  # PNG mask, 255 where the image has content; None: everywhere
    depth: SensorDepth | None = None
    exposure_ev: float | None = None  # see `PhotoInfo.exposure_ev`
    taken_at: float | None = None  # seconds since 1970; None without a time zone
    lens: RadialLens | None = None  # before undistortion; None if unknown or not radial


@dataclass(frozen=True)
class GivenLabels:
    """Label maps of the upload, which replace the detector."""

    dictionary: Dictionary  # of `labels.json`, in id order
    map_paths: tuple[Path | None, ...]  # 8- or 16-bit gray PNGs by view
    """Same size and undistortion as the view's image, nearest-neighbor resampled; None for a view without."""


@dataclass(frozen=True)
class ScaleEstimate:
    """Length of a scene unit, with its uncertainty."""

    source: str  # "tags", "arkit", "sensor_depth" or "gps"; several, the surest first, joined by "+"
    meters_per_unit: float  # of the world before scaling to meters
    relative_error_95: float  # half of the 95 % interval as a share: a length l is l ± l·relative_error_95


@dataclass(frozen=True)
class VerticalEstimate:
    """Estimate of the vertical, which is +z."""

    source: VerticalSource
    deviation_deg: float  # 1 σ of its angle


@dataclass(frozen=True)
class CaptureReport:
    """Report on a capture for users."""

    source: Source
    images: int  # usable ones in the upload
    unregistered: tuple[str, ...] = ()  # names of images without a pose
    models: tuple[int, ...] = ()  # images of all disconnected reconstructions, largest first
    mean_reprojection_error_px: float = 0.0  # 0 for an upload with poses and no points
    warnings: tuple[str, ...] = ()
    splat: str = ""  # name of the upload's splat file
    scale: ScaleEstimate | None = None  # of a metric capture, if measured here
    photos: tuple[PhotoVerdict, ...] = ()  # by name
    withheld: WithheldReport | None = None  # None if nothing was looked for
    vertical: VerticalEstimate | None = None  # None with poses of the upload, or if unknown
    left_out: Mapping[str, str] = field(default_factory=dict)  # as in `ValidatedUpload`; in no other number


@dataclass(frozen=True)
class Capture:
    """Images with cameras and sparse points."""

    views: tuple[View, ...]  # registered images, sorted by name
    points: NDArray[np.float32]  # [P, 3], world, scene units
    point_colors: NDArray[np.uint8]  # [P, 3], RGB
    scale: Scale
    report: CaptureReport
    given_labels: GivenLabels | None = field(default=None)
    test_names: tuple[str, ...] = ()  # views that the upload itself reserves for testing
    splat: Path | None = None  # arrays of the upload's splat (`load_splat`), in the world of the views

    def __post_init__(self) -> None:
        assert self.points.ndim == 2 and self.points.shape[1] == 3 and self.points.dtype == np.float32
        assert self.point_colors.shape == self.points.shape and self.point_colors.dtype == np.uint8
