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
from fastsplat_contract.camera import Camera, PosedCamera
from fastsplat_contract.operations import Privacy
from fastsplat_contract.photo_verdicts import PhotoVerdict
from fastsplat_contract.scenes import Scale, VerticalSource

Source = Literal["images", "video", "colmap", "nerfstudio", "splat", "polycam", "record3d", "arkit"]


@dataclass(frozen=True)
class ValidatedUpload:
    """An upload that was checked and unpacked; its folder is all that `build_capture` needs.

    Attributes:
        folder: where it lies, inside the raw upload's folder.
        images: images in it; 0 for a video, whose frames are chosen later.
        has_labels: whether label maps came with it, so that no detector will run.
        warnings: what will not be used, as sentences for people.
        gaussians: of the splat that it brings; 0 for none.
        left_out: why files and frames are not used that were meant to be, by their names in the upload.
    """

    folder: Path
    source: Source
    images: int
    has_labels: bool = False
    warnings: tuple[str, ...] = ()
    gaussians: int = 0
    left_out: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class SensorDepth:
    """What a depth sensor measured of a view: camera z, in a 16-bit gray PNG.

    Attributes:
        path: the PNG in the capture's folder; 0 where nothing was measured.
        camera: pinhole intrinsics of the map's own pixels; its pose is the view's.
        unit: scene units of one step.
    """

    path: Path
    camera: Camera
    unit: float


@dataclass(frozen=True)
class View:
    """One registered image: upright, undistorted, RGB, of exactly the camera's size.

    Attributes:
        posed: pinhole intrinsics of the stored image, pose, and the image's name in the upload.
        image_path: the undistorted image (PNG or JPEG) in the capture's folder.
        valid_path: PNG mask, 255 where the undistorted image has content, or None when every pixel has.
        depth: what a depth sensor measured, if there was one.
        exposure_ev: how much of the light the photo took by its EXIF, EV: log2(seconds × ISO / 100 / f-number²); None
            where it does not say.
        taken_at: when the photo was taken, seconds since 1970; None where it does not say it with its time zone.
        lens: of the photo before it was undistorted; None where that is not known, or two numbers do not say it.
    """

    posed: PosedCamera
    image_path: Path
    valid_path: Path | None = None
    depth: SensorDepth | None = None
    exposure_ev: float | None = None
    taken_at: float | None = None
    lens: RadialLens | None = None


@dataclass(frozen=True)
class GivenLabels:
    """Label maps of the upload; with them, no detector runs.

    Attributes:
        dictionary: the names of `labels.json`, in id order.
        map_paths: one 8- or 16-bit gray PNG per view, in the order of `Capture.views`, or None for a view without;
            same size and undistortion as the view's image, nearest-neighbor resampled.
    """

    dictionary: Dictionary
    map_paths: tuple[Path | None, ...]


@dataclass(frozen=True)
class ScaleEstimate:
    """How long a scene unit is, and how sure that is.

    Attributes:
        source: what told it: "tags", printed tags of a known side; "arkit", a phone's tracking; "sensor_depth", its
            depth sensor; "gps", the places in the photos' EXIF; several, the surest first, joined by "+".
        meters_per_unit: of the world before it was scaled to meters.
        relative_error_95: half of the 95 % interval as a share of the scale: a length l is l ± l·relative_error_95.
    """

    source: str
    meters_per_unit: float
    relative_error_95: float


@dataclass(frozen=True)
class WithheldReport:
    """What a capture withholds.

    Attributes:
        privacy: what was promised, or None.
        photos: of how many photos pixels are withheld.
        share: of the pixels of all photos, each photo counted alike, 0..1.
    """

    privacy: Privacy | None
    photos: int
    share: float


@dataclass(frozen=True)
class VerticalEstimate:
    """Which way is up in a world whose +z it is, and how sure that is.

    Attributes:
        source: what told it; see `VerticalSource` of the contract.
        deviation_deg: 1 sigma of its angle, degrees.
    """

    source: VerticalSource
    deviation_deg: float


@dataclass(frozen=True)
class CaptureReport:
    """What a user should know about a capture: images without a pose, accuracy, warnings.

    Attributes:
        images: usable images in the upload.
        unregistered: names of images without a pose.
        models: sizes (registered images) of all disconnected reconstructions, largest first; more than one is a split.
        mean_reprojection_error_px: over the points of the reconstruction; 0 for an upload with poses and no points.
        splat: name of the splat file that came with the upload, or "".
        scale: what the meters of a metric capture rest on, where they were measured here; None where they were not.
        vertical: what +z rests on; None where poses came with the upload, or nothing tells what is up.
        photos: what became of each image, by name; empty if nobody has looked.
        withheld: which share of the photos entered nothing; None where nobody looked for any.
        left_out: as `ValidatedUpload.left_out`; these are in no other number.
    """

    source: Source
    images: int
    unregistered: tuple[str, ...] = ()
    models: tuple[int, ...] = ()
    mean_reprojection_error_px: float = 0.0
    warnings: tuple[str, ...] = ()
    splat: str = ""
    scale: ScaleEstimate | None = None
    photos: tuple[PhotoVerdict, ...] = ()
    withheld: WithheldReport | None = None
    vertical: VerticalEstimate | None = None
    left_out: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Capture:
    """Images with cameras and sparse points.

    Attributes:
        views: registered images, sorted by name.
        points: float32 [P, 3] world positions, scene units.
        point_colors: uint8 [P, 3] RGB.
        scale: whether scene units are meters.
        given_labels: label maps of the upload, if any.
        test_names: names of the views that the upload itself sets apart for testing; empty if it says nothing.
        splat: the arrays of the splat that came with the upload (`load_splat`), in the world of the views; None where
            the scene is to be trained.
    """

    views: tuple[View, ...]
    points: NDArray[np.float32]
    point_colors: NDArray[np.uint8]
    scale: Scale
    report: CaptureReport
    given_labels: GivenLabels | None = field(default=None)
    test_names: tuple[str, ...] = ()
    splat: Path | None = None

    def __post_init__(self) -> None:
        assert self.points.ndim == 2 and self.points.shape[1] == 3 and self.points.dtype == np.float32
        assert self.point_colors.shape == self.points.shape and self.point_colors.dtype == np.uint8
