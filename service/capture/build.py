"""Builds a `Capture` from a validated upload."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.capture.camera_model import CameraModel, check_camera_model, compute_undistortion
from fastsplat.service.capture.capture_files import holds_capture, load_capture, save_capture
from fastsplat.service.capture.geometry import normalize_world
from fastsplat.service.capture.image_decoder import ImageDecoder
from fastsplat.service.capture.image_decoding import reduced_size
from fastsplat.service.capture.image_io import PhotoInfo, load_rgb, save_rgb
from fastsplat.service.capture.label_maps import LabelTable, read_label_table
from fastsplat.service.capture.mapping_snapshots import take_placed
from fastsplat.service.capture.photo_quality import PhotoMatches, PhotoQuality, judge_photos, measure_photo
from fastsplat.service.capture.placed_cameras import PlacedViews
from fastsplat.service.capture.posed_input import PosedImage, mask_warning
from fastsplat.service.capture.sandbox import Listener, run_sandboxed
from fastsplat.service.capture.scale_tags import in_meters
from fastsplat.service.capture.settings import CaptureSettings
from fastsplat.service.capture.splat_input import in_splat_frame, take_splat
from fastsplat.service.capture.types import Capture, CaptureReport, GivenLabels, View
from fastsplat.service.capture.upload_manifest import UploadManifest, read_manifest
from fastsplat.service.capture.upload_validation import read_posed_dataset
from fastsplat.service.capture.view_writer import (
    IMAGES,
    LABELS,
    MASKS,
    SourceImage,
    view_geometry,
    write_view,
)
from fastsplat.service.common.atomic import atomic_directory
from fastsplat.service.common.file_names import list_names
from fastsplat.service.common.progress import Progress, ProgressEvent
from fastsplat_contract.errors import InvalidInputError, ReconstructionError

_STAGE = "capture"
_DECODING = "decoding"
_FILM_DIAGONAL_MM = float(np.hypot(36.0, 24.0))


def build_capture(
    validated_dir: Path,
    out_dir: Path,
    settings: CaptureSettings,
    progress: Progress,
    on_placed: Callable[[PlacedViews], None] | None = None,
) -> Capture:
    """The capture of a validated upload, written to `out_dir`, which appears only when complete.

    Images alone get their poses by structure from motion, and a normalized world with +z up (see `normalize_world`).
    Poses of the upload stay as they are, and get points by triangulation if the upload has none and no splat. A splat
    alone has no views yet: see `service.splat_import`.

    Args:
        validated_dir: `ValidatedUpload.folder`, or the upload's folder that holds it.
        out_dir: new, empty, or an earlier capture, which is replaced.
        settings: sizes of images, limits and options of structure from motion.
        progress: receives events of the stage "capture".
        on_placed: is shown the cameras while structure from motion places them, now and then.

    Raises:
        ReconstructionError: no usable geometry, or no view with a valid pixel.
        ResourceError: structure from motion exceeded its memory or time limit.
        InvalidInputError: `validated_dir` has no validated upload, or `out_dir` is in use.
    """
    manifest, files = read_manifest(validated_dir)
    if manifest.source == "splat":
        raise InvalidInputError(
            f"{manifest.splat} has no views",
            field="upload",
            hint="Build its capture by fastsplat.service.pipeline.build_views, which renders them.",
        )
    if out_dir.exists() and any(out_dir.iterdir()) and not holds_capture(out_dir):
        raise InvalidInputError(f"{out_dir} is in use", field="out_dir", hint="Name an empty or a new folder.")
    with atomic_directory(out_dir) as partial:
        for name in (IMAGES, MASKS, LABELS):
            (partial / name).mkdir()
        work = partial / "work"
        for folder in (work, work / IMAGES, work / _DECODING):
            folder.mkdir()
        with ImageDecoder(work / _DECODING, (files, work / IMAGES), settings) as decoder:
            build = _Build(manifest, files, partial, work, settings, progress, decoder, on_placed)
            capture = build.posed() if manifest.poses else build.reconstructed()
        shutil.rmtree(work)
        save_capture(capture, partial)
    progress(ProgressEvent(_STAGE, 1.0, f"{len(capture.views)} views, {len(capture.points)} points"))
    return load_capture(out_dir)


def load_image(view: View) -> NDArray[np.uint8]:
    """uint8 [H, W, 3] RGB of a view, of its camera's size."""
    return load_rgb(view.image_path)


@dataclass(frozen=True)
class _SfmImage:
    """An upright, reduced image as structure from motion reads it.

    Attributes:
        name: of the view.
        file: below the work folder's images.
        width, height: of the reduced pixels.
        camera_group: images of one group share a camera.
        focal_px: by EXIF; 0 if unknown.
        photo: what it was made from; None for a video's frame.
        quality: of its pixels.
    """

    name: str
    file: str
    width: int
    height: int
    camera_group: str
    focal_px: float
    photo: PhotoInfo | None
    quality: PhotoQuality

    def to_request(self) -> dict[str, Any]:
        """As `sfm.reconstruct` takes it."""
        return {
            "file": self.file,
            "width": self.width,
            "height": self.height,
            "group": self.camera_group,
            "focal": self.focal_px,
        }


@dataclass(frozen=True)
class _Views:
    """Views as written, their label maps, the names of those without a valid pixel, and a warning about them."""

    views: tuple[View, ...]
    label_maps: tuple[Path | None, ...]
    masked: tuple[str, ...]
    warnings: tuple[str, ...]


@dataclass(frozen=True)
class _Build:
    manifest: UploadManifest
    files: Path
    out: Path
    work: Path
    settings: CaptureSettings
    progress: Progress
    decoder: ImageDecoder
    on_placed: Callable[[PlacedViews], None] | None

    def reconstructed(self) -> Capture:
        """The capture of images or a video without poses."""
        images = self._video_frames() if self.manifest.source == "video" else self._upright_photos()
        request = {
            "image_folder": str(self.work / IMAGES),
            "images": [image.to_request() for image in images],
            "ordered": self.manifest.source == "video",
            **self.settings.model_dump(),
        }
        result, points, colors = self._run_sfm("reconstruct", request, self._placing_listener(images))
        registered = [image for image in images if image.file in result["poses"]]
        poses, points = normalize_world(np.array([result["poses"][image.file] for image in registered]), points)
        table = self._label_table()
        sources = (
            self._reconstructed_source(image, pose, result["cameras"][image.file], table)
            for image, pose in zip(registered, poses, strict=True)
        )
        written = self._write(sources, len(registered), 0.9, 1.0)
        report = CaptureReport(
            source=self.manifest.source,
            images=len(images),
            unregistered=tuple(image.name for image in images if image.file not in result["poses"]),
            models=tuple(result["models"]),
            mean_reprojection_error_px=result["error_px"],
            warnings=(*self.manifest.warnings, *result["warnings"], *written.warnings),
            photos=judge_photos(
                [image.quality for image in images],
                _poses(written.views),
                {image.name: PhotoMatches(*result["matches"][image.file]) for image in images},
                written.masked,
            ),
        )
        labels = None if table is None else GivenLabels(table.dictionary(), written.label_maps)
        capture = Capture(written.views, points.astype(np.float32), colors, "ARBITRARY", report, labels)
        return self._in_meters(capture)

    def posed(self) -> Capture:
        """The capture of a COLMAP model or a transforms.json."""
        sizes = {photo.path: (photo.width, photo.height) for photo in self.manifest.photos}
        dataset = read_posed_dataset(self.files, self.manifest, sizes, self.settings)
        if self.manifest.splat_frame:
            dataset = in_splat_frame(dataset, self.files, self.manifest, self.settings)
        table = self._label_table() or dataset.labels
        photo_by_path = {photo.path: photo for photo in self.manifest.photos}
        qualities: list[PhotoQuality] = []
        sources = (self._posed_source(image, photo_by_path[image.path], table, qualities) for image in dataset.images)
        written = self._write(sources, len(dataset.images), 0.0, 1.0 if len(dataset.points) else 0.3)
        points, colors, error_px = dataset.points, dataset.point_colors, dataset.mean_reprojection_error_px
        if len(points) == 0 and not self.manifest.splat:  # a splat needs no points to start from
            points, colors, error_px = self._triangulated(written.views)
        has_labels = table is not None and any(written.label_maps)
        report = CaptureReport(
            source=self.manifest.source,
            images=len(self.manifest.photos),
            models=(len(written.views),),
            mean_reprojection_error_px=error_px,
            warnings=(*self.manifest.warnings, *mask_warning(dataset), *written.warnings),
            splat=self.manifest.splat,
            photos=judge_photos(qualities, _poses(written.views), None, written.masked),
        )
        names = {view.posed.name for view in written.views}
        capture = Capture(
            views=written.views,
            points=points,
            point_colors=colors,
            scale=dataset.scale,
            report=report,
            given_labels=GivenLabels(table.dictionary(), written.label_maps) if table and has_labels else None,
            test_names=tuple(name for name in dataset.test_names if name in names),
            splat=take_splat(self.files.parent, self.out) if self.manifest.splat else None,
        )
        # The rows of a splat that was brought stay as they are, so its units stay too.
        return capture if capture.scale == "METRIC" or self.manifest.splat else self._in_meters(capture)

    def _in_meters(self, capture: Capture) -> Capture:
        """The capture in metres if printed tags tell how long they are, else the same."""
        count = len(capture.views)
        return in_meters(capture, self.settings, lambda done: self._report(1.0, f"looking for tags {done}/{count}"))

    def _upright_photos(self) -> list[_SfmImage]:
        images = []
        for index, (photo, name) in enumerate(zip(self.manifest.photos, self.manifest.names, strict=True)):
            self._report(0.15 * index / len(self.manifest.names), f"reading images {index}/{len(self.manifest.names)}")
            width, height = reduced_size(*photo.upright_size, self.settings.max_side)
            file = f"{index:05d}.png"
            pixels = self.decoder.photo(self.files, photo, (width, height))
            save_rgb(pixels, self.work / IMAGES / file)
            focal_px = photo.focal_35mm / _FILM_DIAGONAL_MM * float(np.hypot(width, height))
            group, quality = f"{photo.lens} {width}×{height}", measure_photo(name, pixels)
            images.append(_SfmImage(name, file, width, height, group, focal_px, photo, quality))
        return images

    def _video_frames(self) -> list[_SfmImage]:
        request = {
            "video": str(self.files / self.manifest.video),
            "name": self.manifest.video,
            "folder": str(self.work / IMAGES),
            **self.settings.model_dump(),
        }
        result = run_sandboxed("frames", request, self._task_folder("frames"), self.settings, self._listener(0.0, 0.15))
        width, height = (int(number) for number in result["size"])
        images = []
        for file in result["files"]:
            frame = self.decoder.photo(self.work / IMAGES, _frame_info(file, width, height), (width, height))
            images.append(_SfmImage(file, file, width, height, "video", 0.0, None, measure_photo(file, frame)))
        return images

    def _reconstructed_source(
        self, image: _SfmImage, pose: NDArray[np.float64], camera: list[Any], table: LabelTable | None
    ) -> SourceImage:
        model, width, height, params = camera
        camera_model = CameraModel(model, width, height, tuple(params))
        try:
            check_camera_model(camera_model, field=image.name)
            undistortion = compute_undistortion(camera_model, self.settings.max_side, field=image.name)
        except InvalidInputError as error:
            raise ReconstructionError(
                f"structure from motion gave {image.name} a camera that cannot exist: {error.message}",
                field=image.name,
                hint="Leave out images that are cropped, edited or unlike the others.",
            ) from error
        # Frames of a video were written by a child that met a stranger's bytes, photos by this process.
        frame = _frame_info(image.file, image.width, image.height)
        return SourceImage(
            name=image.name,
            pixels=self.decoder.photo(self.work / IMAGES, frame, (image.width, image.height))
            if image.photo is None
            else load_rgb(self.work / IMAGES / image.file),
            undistortion=undistortion,
            world_from_camera=pose,
            lossless=image.name.lower().endswith(".png") and image.photo is not None,
            label_ids=None if image.photo is None else self._label_ids(image.photo, table, (width, height)),
            exposure_ev=None if image.photo is None else image.photo.exposure_ev,
        )

    def _posed_source(
        self, image: PosedImage, photo: PhotoInfo, table: LabelTable | None, qualities: list[PhotoQuality]
    ) -> SourceImage:
        geometry = view_geometry(image, photo, self.settings)
        pixels = self.decoder.photo(self.files, photo, geometry.size)
        qualities.append(measure_photo(image.name, pixels))
        mask = None
        if image.mask is not None:
            mask = self.decoder.ids(self.files, image.mask, photo, geometry.size) > 0
        unchanged = geometry.undistortion.map_xy is None and geometry.size == photo.upright_size
        return SourceImage(
            name=image.name,
            pixels=pixels,
            undistortion=geometry.undistortion,
            world_from_camera=geometry.world_from_camera,
            lossless=photo.path.lower().endswith(".png") or unchanged,
            label_ids=self._label_ids(photo, table, geometry.size),
            mask=mask,
            exposure_ev=photo.exposure_ev,
        )

    def _label_ids(
        self, photo: PhotoInfo, table: LabelTable | None, size: tuple[int, int]
    ) -> NDArray[np.uint16] | None:
        stored = self.manifest.label_maps.get(photo.path)
        if stored is None or table is None:
            return None
        return table.translate(self.decoder.ids(self.files, stored, photo, size))

    def _label_table(self) -> LabelTable | None:
        return read_label_table(self.files, self.manifest.labels, self.settings) if self.manifest.labels else None

    def _write(self, sources: Iterator[SourceImage], count: int, begin: float, end: float) -> _Views:
        """Views without a valid pixel are left out: nothing could be learnt from them, nor measured on them."""
        written, blank = [], []
        for index, source in enumerate(sources):
            self._report(begin + (end - begin) * index / count, f"undistorting images {index}/{count}")
            view = write_view(source, index, self.out)
            if view is None:
                blank.append(source.name)
            else:
                written.append(view)
        if not written:
            raise ReconstructionError(
                "the masks leave no usable pixel in any image",
                hint="In a mask, 0 is what to ignore; invert the masks, or leave them out.",
            )
        warning = f"{len(blank)} of {count} images are masked entirely and are not used: {list_names(blank)}."
        return _Views(
            views=tuple(view for view, _ in written),
            label_maps=tuple(label_map for _, label_map in written),
            masked=tuple(blank),
            warnings=(warning,) if blank else (),
        )

    def _triangulated(self, views: tuple[View, ...]) -> tuple[NDArray[np.float32], NDArray[np.uint8], float]:
        images = []
        for view in views:
            camera = view.posed.camera
            numbers = [camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy]
            pose = view.posed.camera_from_world().tolist()
            images.append({"file": view.image_path.name, "camera": numbers, "camera_from_world": pose})
        folder = str(self.out / IMAGES)
        request = {"image_folder": folder, "images": images, "ordered": False, **self.settings.model_dump()}
        result, points, colors = self._run_sfm("triangulate", request, self._listener(0.3, 1.0))
        return points.astype(np.float32), colors, float(result["error_px"])

    def _run_sfm(
        self, task: Literal["reconstruct", "triangulate"], request: dict[str, Any], listen: Listener
    ) -> tuple[dict[str, Any], NDArray[np.float64], NDArray[np.uint8]]:
        folder = self._task_folder(task)
        result = run_sandboxed(task, request, folder, self.settings, listen)
        with np.load(folder / "points.npz") as arrays:
            return result, arrays["points"], arrays["colors"]

    def _task_folder(self, task: str) -> Path:
        folder = self.work / task
        folder.mkdir()
        return folder

    def _listener(self, begin: float, end: float) -> Listener:
        return lambda fraction, message: self._report(begin + (end - begin) * fraction, message)

    def _placing_listener(self, images: list[_SfmImage]) -> Listener:
        """As `_listener`, and shows the cameras that are placed."""
        names, folder, listen = {image.file: image.name for image in images}, self.work, self._listener(0.15, 0.9)

        def heard(fraction: float, message: str) -> None:
            listen(fraction, message)
            placed = take_placed(folder / "reconstruct", names, len(images)) if self.on_placed else None
            if placed is not None and self.on_placed is not None:
                self.on_placed(placed)

        return heard

    def _report(self, fraction: float, message: str) -> None:
        self.progress(ProgressEvent(_STAGE, min(1.0, fraction), message))


def _poses(views: tuple[View, ...]) -> dict[str, NDArray[np.float64]]:
    return {view.posed.name: view.posed.world_from_camera for view in views}


def _frame_info(file: str, width: int, height: int) -> PhotoInfo:
    return PhotoInfo(file, width, height, orientation=1, lens="", focal_35mm=0.0)
