"""Builds a `Capture` from a validated upload."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.capture.capture_settings import CaptureSettings
from fastsplat.service.capture.captures import Capture, CaptureReport, GivenLabels, View
from fastsplat.service.capture.formats.capture_files import holds_capture, load_capture, save_capture
from fastsplat.service.capture.formats.depth_maps import DEPTHS
from fastsplat.service.capture.formats.image_io import load_rgb
from fastsplat.service.capture.formats.upload_manifest import UploadManifest, read_manifest
from fastsplat.service.capture.photos.photo_quality import judge_photos, matches_by_name
from fastsplat.service.capture.photos.withholding import WithheldPixels, Withholding
from fastsplat.service.capture.sfm.geometry import normalize_world
from fastsplat.service.capture.sfm.mapping_snapshots import take_placed
from fastsplat.service.capture.sfm.placed_cameras import PlacedViews
from fastsplat.service.capture.sfm.sfm_images import SfmImage, frame_width, photo_ups, upright_photos, video_frames
from fastsplat.service.capture.untrusted.image_decoder import ImageDecoder
from fastsplat.service.capture.untrusted.sandbox import Listener, run_sandboxed
from fastsplat.service.capture.uploads.label_maps import LabelTable, read_label_table
from fastsplat.service.capture.uploads.photo_exclusion import without_photos
from fastsplat.service.capture.uploads.posed_input import mask_warning
from fastsplat.service.capture.uploads.posed_validation import read_validated_dataset
from fastsplat.service.capture.uploads.splat_input import in_splat_frame, take_splat
from fastsplat.service.capture.views.lens_views import ViewLog, test_views
from fastsplat.service.capture.views.view_sources import ViewSources
from fastsplat.service.capture.views.view_writer import IMAGES, LABELS, MASKS, SourceImage, WrittenViews, write_view
from fastsplat.service.capture.world.gps_scale import with_gps
from fastsplat.service.capture.world.gravity import vertical_of_capture
from fastsplat.service.capture.world.posed_geometry import PosedTask, SfmAnswer, posed_geometry
from fastsplat.service.capture.world.scale_tags import in_meters
from fastsplat.service.common.file_names import list_names
from fastsplat.service.common.files import atomic_directory
from fastsplat.service.common.progress import Progress, ProgressEvent
from fastsplat_contract.errors import InvalidInputError, ReconstructionError

_STAGE = "capture"
_DECODING = "decoding"
_FEWEST_IMAGES = 2


def build_capture(
    validated_dir: Path,
    out_dir: Path,
    settings: CaptureSettings,
    progress: Progress,
    on_placed: Callable[[PlacedViews], None] | None = None,
    withholding: Withholding | None = None,
    exclude: Collection[str] = (),
) -> Capture:
    """Builds the capture of a validated upload in `out_dir`, which appears only when complete.

    Images alone get poses by structure from motion and a normalized world (`normalize_world`). Poses of the upload
    stay unchanged; points are triangulated if it has neither points nor a splat. Captures of a splat alone are built by
    `service.splat_import`.

    Args:
        validated_dir: `ValidatedUpload.folder`, or the raw upload's folder around it.
        out_dir: new, empty, or an earlier capture, which is replaced.
        on_placed: receives the cameras placed so far, now and then during structure from motion.
        withholding: pixels of photos that are not used at all; None: all are used.
        exclude: paths in the upload of photos that are left out.

    Raises:
        ReconstructionError: no usable geometry, or no view with a valid pixel.
        ResourceError: structure from motion exceeded its memory or time limit.
        InvalidInputError: `validated_dir` has no validated upload, `out_dir` is in use, or too few photos are left.
    """
    manifest, files = read_manifest(validated_dir)
    manifest = without_photos(manifest, exclude)
    if manifest.source == "splat":
        raise InvalidInputError(
            f"{manifest.splat} has no views",
            field="upload",
            hint="Build its capture by fastsplat.service.jobs.create_scene.build_views, which renders them.",
        )
    if manifest.spherical and settings.lens == "auto":
        settings = settings.model_copy(update={"lens": "panorama"})
    if out_dir.exists() and any(out_dir.iterdir()) and not holds_capture(out_dir):
        raise InvalidInputError(f"{out_dir} is in use", field="out_dir", hint="Name an empty or a new folder.")
    with atomic_directory(out_dir) as partial:
        for name in (IMAGES, MASKS, LABELS, DEPTHS):
            (partial / name).mkdir()
        work = partial / "work"
        for folder in (work, work / IMAGES, work / _DECODING):
            folder.mkdir()
        with ImageDecoder(work / _DECODING, (files, work / IMAGES), settings) as decoder:
            held = WithheldPixels(withholding, work / "withheld")
            build = _Build(manifest, files, partial, work, settings, progress, decoder, on_placed, held)
            capture = build.posed() if manifest.poses else build.reconstructed()
            capture = replace(capture, report=replace(capture.report, left_out=manifest.left_out))
        shutil.rmtree(work)
        save_capture(capture, partial)
    progress(ProgressEvent(_STAGE, 1.0, f"{len(capture.views)} views, {len(capture.points)} points"))
    return load_capture(out_dir)


def load_image(view: View) -> NDArray[np.uint8]:
    """Loads a view's image, uint8 [H, W, 3] RGB."""
    return load_rgb(view.image_path)


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
    held: WithheldPixels

    def reconstructed(self) -> Capture:
        """Builds the capture of images or a video without poses."""
        log = ViewLog()
        images = self._video_frames() if self.manifest.source == "video" else self._upright_photos(log)
        if len(images) < _FEWEST_IMAGES:
            raise _nothing_left(len(images) + len(log.left_out))
        request = {
            "image_folder": str(self.work / IMAGES),
            "images": [image.to_request() for image in images],
            "ordered": self.manifest.source == "video",
            **self.held.request,
            **self.settings.model_dump(),
        }
        result, points, colors = self._run_sfm("reconstruct", request, self._placing_listener(images))
        registered = [image for image in images if image.file in result["poses"]]
        poses = np.array([result["poses"][image.file] for image in registered])
        vertical = vertical_of_capture(poses, points, photo_ups(registered, poses))
        poses, points = normalize_world(poses, points, None if vertical is None else vertical.up)
        table = self._label_table()
        matches = matches_by_name(result["matches"], {image.file: image.name for image in images})
        log.left_out.update(
            {image.name: result["impossible"][image.file] for image in images if image.file in result["impossible"]}
        )
        cameras, factory = result["cameras"], self._sources(table, log)
        sources = (
            source
            for image, pose in zip(registered, poses, strict=True)
            for source in factory.reconstructed(image, pose, cameras[image.file], matches[image.name])
        )
        written = self._write(sources, len(registered), 0.9, 1.0)
        unregistered = [image for image in images if image.file not in result["poses"] or image.name in log.left_out]
        names = {image.name for image in unregistered} | log.left_out.keys()
        report = CaptureReport(
            source=self.manifest.source,
            images=len(log.qualities) + len(names),
            unregistered=tuple(sorted(names)),
            models=tuple(result["models"]),
            mean_reprojection_error_px=result["error_px"],
            warnings=(*self.manifest.warnings, *result["warnings"], *log.warnings(), *written.warnings),
            photos=judge_photos(
                [*log.qualities, *(image.quality for image in unregistered)],
                _poses(written.views),
                {image.name: matches[image.name] for image in unregistered} | log.matches,
                log.left_out | dict.fromkeys(written.masked, "masked"),
            ),
            vertical=None if vertical is None else vertical.estimate,
        )
        labels = None if table is None else GivenLabels(table.dictionary(), written.label_maps)
        report = self.held.reported(report)
        capture = Capture(written.views, points.astype(np.float32), colors, "ARBITRARY", report, labels)
        return with_gps(self._in_meters(capture), log.places([view.posed.name for view in written.views]))

    def posed(self) -> Capture:
        """Builds the capture of an upload with poses."""
        dataset = read_validated_dataset(self.files, self.manifest, self.settings)
        if self.manifest.splat_frame:
            dataset = in_splat_frame(dataset, self.files, self.manifest, self.settings)
        table = self._label_table() or dataset.labels
        photo_by_path = {photo.path: photo for photo in self.manifest.photos}
        log = ViewLog()
        factory = self._sources(table, log)
        sources = (source for image in dataset.images for source in factory.posed(image, photo_by_path[image.path]))
        written = self._write(sources, len(dataset.images), 0.0, 0.3)
        points, colors, error_px = dataset.points, dataset.point_colors, dataset.mean_reprojection_error_px
        views, scale, notes = written.views, None, tuple[str, ...]()
        if not self.manifest.splat:  # a splat needs no points to start from
            self.held.mask_features(views)
            geometry = posed_geometry(dataset, views, self.out / IMAGES, self.settings, self._run_posed)
            views, points, colors, error_px = geometry.views, geometry.points, geometry.colors, geometry.error_px
            scale, notes = geometry.scale, geometry.warnings
        has_labels = table is not None and any(written.label_maps)
        report = CaptureReport(
            source=self.manifest.source,
            images=len(log.qualities) + len(log.left_out),
            unregistered=tuple(sorted(log.left_out)),
            models=(len(written.views),),
            mean_reprojection_error_px=error_px,
            warnings=(*self.manifest.warnings, *mask_warning(dataset), *log.warnings(), *written.warnings, *notes),
            splat=self.manifest.splat,
            photos=judge_photos(
                log.qualities, _poses(views), None, log.left_out | dict.fromkeys(written.masked, "masked")
            ),
            scale=scale,
        )
        names = [view.posed.name for view in written.views]
        capture = Capture(
            views=views,
            points=points,
            point_colors=colors,
            scale="METRIC" if scale is not None else dataset.scale,
            report=self.held.reported(report),
            given_labels=GivenLabels(table.dictionary(), written.label_maps) if table and has_labels else None,
            test_names=test_views(dataset.test_names, names),
            splat=take_splat(self.files.parent, self.out) if self.manifest.splat else None,
        )
        # The rows of an imported splat stay unchanged, so its units stay, too.
        exact = capture.scale == "METRIC" and capture.report.scale is None
        return capture if exact or self.manifest.splat else self._in_meters(capture)

    def _in_meters(self, capture: Capture) -> Capture:
        """Scales a capture to meters by printed tags, if there are any."""
        count = len(capture.views)
        return in_meters(capture, self.settings, lambda done: self._report(1.0, f"looking for tags {done}/{count}"))

    def _sources(self, table: LabelTable | None, log: ViewLog) -> ViewSources:
        images = self.work / IMAGES
        return ViewSources(self.manifest, self.files, images, self.settings, self.decoder, self.held, table, log)

    def _upright_photos(self, log: ViewLog) -> list[SfmImage]:
        photos = upright_photos(
            self.manifest, self.files, self.work / IMAGES, self.settings, self.decoder, self.held, log.left_out
        )
        images, count = [], len(self.manifest.names)
        for image in photos:
            images.append(image)
            done = min(count, len(images))
            self._report(0.15 * done / count, f"reading images {done}/{count}")
        return images

    def _video_frames(self) -> list[SfmImage]:
        panorama = self.settings.lens == "panorama"
        request = {
            "video": str(self.files / self.manifest.video),
            "name": self.manifest.video,
            "folder": str(self.work / IMAGES),
            **self.settings.model_dump(),
            "max_side": frame_width(self.settings),
            "video_frames": self.settings.panorama_frames if panorama else self.settings.video_frames,
            "by_place": self.held.promised,  # else withheld people would influence which frame is sharpest
        }
        result = run_sandboxed("frames", request, self._task_folder("frames"), self.settings, self._listener(0.0, 0.15))
        width, height = (int(number) for number in result["size"])
        images, video = self.work / IMAGES, self.manifest.video
        frames = video_frames(result["files"], (width, height), video, images, self.settings, self.decoder, self.held)
        return list(frames)

    def _label_table(self) -> LabelTable | None:
        return read_label_table(self.files, self.manifest.labels, self.settings) if self.manifest.labels else None

    def _write(self, sources: Iterator[SourceImage], count: int, begin: float, end: float) -> WrittenViews:
        """Writes the views except those without a valid pixel."""
        written, blank = [], []
        for index, source in enumerate(sources):
            self._report(begin + (end - begin) * index / count, f"undistorting images {min(index, count)}/{count}")
            view = write_view(source, index, self.out)
            if view is None:
                blank.append(source.name)
            else:
                written.append(view)
        if not written and not blank:
            raise _nothing_left(count)
        if not written:
            raise ReconstructionError(
                "the masks leave no usable pixel in any image",
                hint="In a mask, 0 is what to ignore; invert the masks, or leave them out.",
            )
        warning = f"{len(blank)} of {count} images are masked entirely and are not used: {list_names(blank)}."
        return WrittenViews(
            views=tuple(view for view, _ in written),
            label_maps=tuple(label_map for _, label_map in written),
            masked=tuple(blank),
            warnings=(warning,) if blank else (),
        )

    def _run_posed(self, task: PosedTask, request: dict[str, Any]) -> SfmAnswer:
        return self._run_sfm(task, request | self.held.request, self._listener(0.3, 1.0))

    def _run_sfm(
        self, task: Literal["reconstruct"] | PosedTask, request: dict[str, Any], listen: Listener
    ) -> SfmAnswer:
        result = run_sandboxed(task, request, folder := self._task_folder(task), self.settings, listen)
        with np.load(folder / "points.npz") as arrays:
            return result, arrays["points"], arrays["colors"]

    def _task_folder(self, task: str) -> Path:
        folder = self.work / task
        folder.mkdir()
        return folder

    def _listener(self, begin: float, end: float) -> Listener:
        return lambda fraction, message: self._report(begin + (end - begin) * fraction, message)

    def _placing_listener(self, images: list[SfmImage]) -> Listener:
        """Makes a listener that also reports placed cameras, never fewer than before."""
        names, folder, listen = {image.file: image.name for image in images}, self.work, self._listener(0.15, 0.9)
        last_count = 0

        def heard(fraction: float, message: str) -> None:
            nonlocal last_count
            listen(fraction, message)
            placed = take_placed(folder / "reconstruct", names, len(images)) if self.on_placed else None
            if placed is not None and self.on_placed is not None and placed.placed >= last_count:
                last_count = placed.placed
                self.on_placed(placed)

        return heard

    def _report(self, fraction: float, message: str) -> None:
        self.progress(ProgressEvent(_STAGE, min(1.0, fraction), message))


def _nothing_left(photos: int) -> ReconstructionError:
    return ReconstructionError(
        f"hardly one of {photos} photos can be used: they are damaged, or their lens cannot be undone",
        limit=f"at least {_FEWEST_IMAGES} photos",
        hint="Copy the photos from the camera again; with poses, check the cameras' distortion parameters.",
    )


def _poses(views: tuple[View, ...]) -> dict[str, NDArray[np.float64]]:
    return {view.posed.name: view.posed.world_from_camera for view in views}
