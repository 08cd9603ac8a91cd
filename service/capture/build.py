"""From an admitted upload to a `Capture`."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.capture.files import holds_capture, load_capture, save_capture
from fastsplat.service.capture.folders import appearing
from fastsplat.service.capture.frame import settle
from fastsplat.service.capture.given import GivenPhoto, GivenPoses
from fastsplat.service.capture.images import PhotoInfo, load_rgb, load_upright, save_rgb
from fastsplat.service.capture.isolation import Listener, run_isolated
from fastsplat.service.capture.labels import LabelTable
from fastsplat.service.capture.lens import Lens, check_lens, undistortion
from fastsplat.service.capture.manifest import Manifest, read_manifest
from fastsplat.service.capture.settings import CaptureSettings
from fastsplat.service.capture.types import Capture, CaptureReport, GivenLabels, View
from fastsplat.service.capture.upload import read_labels, read_poses
from fastsplat.service.capture.views import (
    IMAGES,
    LABELS,
    MASKS,
    Shot,
    load_upright_map,
    placement,
    reduce,
    reduced_size,
    write_view,
)
from fastsplat.service.common.progress import Progress, ProgressEvent
from fastsplat_contract.errors import InvalidInputError, ReconstructionError

_STAGE = "capture"
_FILM_DIAGONAL_MM = float(np.hypot(36.0, 24.0))


def build_capture(admitted_dir: Path, out_dir: Path, settings: CaptureSettings, progress: Progress) -> Capture:
    """Images with cameras and points, written to `out_dir`, which appears only when complete.

    Images alone get their poses by structure from motion, and a world frame of the order of one, +z up (see
    `frame.settle`); poses that were given stay as they are, and get points by triangulation if none were given.

    Args:
        admitted_dir: `AdmittedUpload.folder`, or the upload's folder that holds it.
        out_dir: new, empty, or an earlier capture, which is replaced.
        progress: receives events of the stage "capture".

    Raises:
        ReconstructionError: no usable geometry.
        ResourceError: structure from motion hit its memory or time limit.
        InvalidInputError: nothing was admitted in `admitted_dir`.
    """
    manifest, files = read_manifest(admitted_dir)
    if out_dir.exists() and any(out_dir.iterdir()) and not holds_capture(out_dir):
        raise InvalidInputError(f"{out_dir} is in use", field="out_dir", hint="Name an empty or a new folder.")
    with appearing(out_dir) as partial:
        for name in (IMAGES, MASKS, LABELS):
            (partial / name).mkdir()
        work = partial / "work"
        work.mkdir()
        build = _Build(manifest, files, partial, work, settings, progress)
        capture = build.posed() if manifest.poses else build.reconstructed()
        shutil.rmtree(work)
        save_capture(capture, partial)
    progress(ProgressEvent(_STAGE, 1.0, f"{len(capture.views)} views, {len(capture.points)} points"))
    return load_capture(out_dir)


def load_image(view: View) -> NDArray[np.uint8]:
    """uint8 [H, W, 3] RGB of a view, of its camera's size."""
    return load_rgb(view.image_path)


@dataclass(frozen=True)
class _Work:
    """An upright, reduced image that structure from motion looks at."""

    name: str
    file: str
    width: int
    height: int
    lens: str
    focal_px: float
    photo: PhotoInfo | None


@dataclass(frozen=True)
class _Build:
    manifest: Manifest
    files: Path
    out: Path
    work: Path
    settings: CaptureSettings
    progress: Progress

    def reconstructed(self) -> Capture:
        """Images or a video, without poses."""
        images = self._frames() if self.manifest.source == "video" else self._upright_photos()
        request = {
            "image_folder": str(self.work / IMAGES),
            "images": [_as_request(image) for image in images],
            "ordered": self.manifest.source == "video",
            **self.settings.model_dump(),
        }
        found, points, colors = self._isolated("reconstruct", request, self._listener(0.15, 0.9))
        placed = [image for image in images if image.file in found["poses"]]
        poses, points = settle(np.array([found["poses"][image.file] for image in placed]), points)
        table = self._table()
        shots = (
            self._reconstructed_shot(image, pose, found["lenses"][image.file], table)
            for image, pose in zip(placed, poses, strict=True)
        )
        views, maps = self._write(shots, len(placed), 0.9, 1.0)
        missing = tuple(image.name for image in images if image.file not in found["poses"])
        report = CaptureReport(
            source=self.manifest.source,
            images=len(images),
            unregistered=missing,
            models=tuple(found["models"]),
            mean_reprojection_error_px=found["error_px"],
            warnings=(*self.manifest.warnings, *found["warnings"]),
        )
        given = None if table is None else GivenLabels(table.dictionary(), maps)
        return Capture(views, points.astype(np.float32), colors, "ARBITRARY", report, given)

    def posed(self) -> Capture:
        """A COLMAP model or a transforms.json."""
        sizes = {photo.path: (photo.width, photo.height) for photo in self.manifest.photos}
        poses = read_poses(self.files, self.manifest, sizes, self.settings)
        table = self._table() or poses.labels
        by_path = {photo.path: photo for photo in self.manifest.photos}
        shots = (self._posed_shot(given, by_path[given.path], table) for given in poses.photos)
        views, maps = self._write(shots, len(poses.photos), 0.0, 1.0 if len(poses.points) else 0.3)
        points, colors, error_px = poses.points, poses.point_colors, poses.mean_reprojection_error_px
        if len(points) == 0:
            points, colors, error_px = self._triangulated(views)
        given_labels = GivenLabels(table.dictionary(), maps) if table is not None and any(maps) else None
        report = CaptureReport(
            source=self.manifest.source,
            images=len(self.manifest.photos),
            models=(len(views),),
            mean_reprojection_error_px=error_px,
            warnings=(*self.manifest.warnings, *_mask_warning(poses)),
        )
        return Capture(views, points, colors, poses.scale, report, given_labels, poses.test_names)

    def _upright_photos(self) -> list[_Work]:
        (self.work / IMAGES).mkdir()
        made = []
        for index, (photo, name) in enumerate(zip(self.manifest.photos, self.manifest.names, strict=True)):
            self._tell(0.15 * index / len(self.manifest.names), f"reading images {index}/{len(self.manifest.names)}")
            width, height = reduced_size(*photo.upright_size, self.settings.max_side)
            file = f"{index:05d}.png"
            pixels = reduce(load_upright(self.files, photo, self.settings), (width, height))
            save_rgb(pixels, self.work / IMAGES / file)
            focal = photo.focal_35mm / _FILM_DIAGONAL_MM * float(np.hypot(width, height))
            made.append(_Work(name, file, width, height, f"{photo.lens} {width}×{height}", focal, photo))
        return made

    def _frames(self) -> list[_Work]:
        (self.work / IMAGES).mkdir()
        request = {
            "video": str(self.files / self.manifest.video),
            "name": self.manifest.video,
            "folder": str(self.work / IMAGES),
            **self.settings.model_dump(),
        }
        found = run_isolated("frames", request, self._task_folder("frames"), self.settings, self._listener(0.0, 0.15))
        height, width = load_rgb(self.work / IMAGES / found["files"][0]).shape[:2]
        return [_Work(file, file, width, height, "video", 0.0, None) for file in found["files"]]

    def _reconstructed_shot(
        self, image: _Work, pose: NDArray[np.float64], lens: list[Any], table: LabelTable | None
    ) -> Shot:
        model, width, height, params = lens
        found = Lens(model, width, height, tuple(params))
        try:
            check_lens(found, field=image.name)
            way = undistortion(found, self.settings.max_side, field=image.name)
        except InvalidInputError as error:
            raise ReconstructionError(
                f"the lens found for {image.name} is none: {error.message}",
                field=image.name,
                hint="Leave out images that are cropped, edited or unlike the others.",
            ) from error
        return Shot(
            name=image.name,
            pixels=load_rgb(self.work / IMAGES / image.file),
            way=way,
            world_from_camera=pose,
            lossless=image.name.lower().endswith(".png") and image.photo is not None,
            ids=None if image.photo is None else self._ids(image.photo, table, (width, height)),
        )

    def _posed_shot(self, given: GivenPhoto, photo: PhotoInfo, table: LabelTable | None) -> Shot:
        placed = placement(given, photo, self.settings)
        mask = None
        if given.mask is not None:
            mask = load_upright_map(self.files, given.mask, photo, placed.size, self.settings) > 0
        plain = placed.way.map_xy is None and placed.size == photo.upright_size
        return Shot(
            name=given.name,
            pixels=reduce(load_upright(self.files, photo, self.settings), placed.size),
            way=placed.way,
            world_from_camera=placed.world_from_camera,
            lossless=photo.path.lower().endswith(".png") or plain,
            ids=self._ids(photo, table, placed.size),
            mask=mask,
        )

    def _ids(self, photo: PhotoInfo, table: LabelTable | None, size: tuple[int, int]) -> NDArray[np.uint16] | None:
        stored = self.manifest.label_maps.get(photo.path)
        if stored is None or table is None:
            return None
        return table.translate(load_upright_map(self.files, stored, photo, size, self.settings))

    def _table(self) -> LabelTable | None:
        return read_labels(self.files, self.manifest.labels, self.settings) if self.manifest.labels else None

    def _write(
        self, shots: Iterator[Shot], count: int, begin: float, end: float
    ) -> tuple[tuple[View, ...], tuple[Path | None, ...]]:
        written = []
        for index, shot in enumerate(shots):
            self._tell(begin + (end - begin) * index / count, f"undistorting images {index}/{count}")
            written.append(write_view(shot, index, self.out))
        return tuple(view for view, _ in written), tuple(label_map for _, label_map in written)

    def _triangulated(self, views: tuple[View, ...]) -> tuple[NDArray[np.float32], NDArray[np.uint8], float]:
        listed = []
        for view in views:
            camera = view.posed.camera
            numbers = [camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy]
            pose = view.posed.camera_from_world().tolist()
            listed.append({"file": view.image_path.name, "camera": numbers, "camera_from_world": pose})
        folder = str(self.out / IMAGES)
        request = {"image_folder": folder, "images": listed, "ordered": False, **self.settings.model_dump()}
        found, points, colors = self._isolated("triangulate", request, self._listener(0.3, 1.0))
        return points.astype(np.float32), colors, float(found["error_px"])

    def _isolated(
        self, task: Any, request: dict[str, Any], listen: Listener
    ) -> tuple[dict[str, Any], NDArray[np.float64], NDArray[np.uint8]]:
        folder = self._task_folder(task)
        found = run_isolated(task, request, folder, self.settings, listen)
        with np.load(folder / "points.npz") as arrays:
            return found, arrays["points"], arrays["colors"]

    def _task_folder(self, task: str) -> Path:
        folder = self.work / task
        folder.mkdir()
        return folder

    def _listener(self, begin: float, end: float) -> Listener:
        return lambda fraction, message: self._tell(begin + (end - begin) * fraction, message)

    def _tell(self, fraction: float, message: str) -> None:
        self.progress(ProgressEvent(_STAGE, min(1.0, fraction), message))


def _as_request(image: _Work) -> dict[str, Any]:
    return {
        "file": image.file,
        "width": image.width,
        "height": image.height,
        "group": image.lens,
        "focal": image.focal_px,
    }


def _mask_warning(poses: GivenPoses) -> tuple[str, ...]:
    masked = sum(photo.mask is not None for photo in poses.photos)
    if not masked:
        return ()
    return (
        f"{masked} frames have a mask_path and the document no labels: what is 0 in a mask is ignored. "
        "For label maps, name their ids under labels.",
    )
