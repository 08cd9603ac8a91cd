"""A finished scene without some of its photos: the capture that the others make, as if those had never been sent.

Its scene is then trained anew. Nothing of a withdrawn photo gets into it: points are triangulated anew, as nobody knows
which photos an old one and its color come from; label maps are kept a photo each; cameras stay, which were once placed
with the help of all photos, and so do what was measured of the whole capture (its scale, which way is up) and its
warnings.
"""

from __future__ import annotations

import shutil
from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from fastsplat.service.capture.formats.kept_capture import (
    keep_points,
    kept_capture,
    share_labels,
    valid_path,
)
from fastsplat.service.capture.photos.scene_photos import photo_folder, photo_path
from fastsplat.service.capture.settings import CaptureSettings
from fastsplat.service.capture.types import (
    Capture,
    CaptureReport,
    ScaleEstimate,
    VerticalEstimate,
    View,
    WithheldReport,
)
from fastsplat.service.capture.untrusted.sandbox import run_sandboxed
from fastsplat.service.capture.uploads.posed_input import PosedDataset, no_points
from fastsplat.service.capture.world.posed_geometry import PosedTask, SfmAnswer, posed_geometry
from fastsplat.service.common.atomic import link_or_copy
from fastsplat.service.common.progress import Progress, ProgressEvent
from fastsplat.service.scene.frames import frame_of
from fastsplat.service.scene.types import TAKEN_AT, Scene
from fastsplat.service.withdrawal_checks import check_retrainable, photos_left
from fastsplat_contract.errors import ReconstructionError

_STAGE = "capture"
_TRIANGULATED = 0.9
"""Of the stage's progress, when the points are there."""


def capture_without(
    scene: Scene,
    folder: Path,
    out: Path,
    withdrawn: Collection[str],
    settings: CaptureSettings,
    progress: Progress,
) -> Capture:
    """The capture of a scene's photos without some.

    Args:
        scene: see `with_joined_cameras`.
        folder: of the current version.
        out: an empty folder, which gets the photos as `service.capture.photos.scene_photos` keeps them with a version.
        withdrawn: names of photos.
        settings: of structure from motion.
        progress: hears of the stage "capture"; may raise `CancelledError`.

    Raises:
        InvalidInputError, NotReadyError: as `photos_left` and `check_retrainable`.
        SceneFileError: a file is damaged.
        ResourceError: triangulation exceeded its memory or time.
    """
    check_retrainable(scene.quality, folder)
    source, photos, work = photo_folder(folder), photo_folder(out), out / "work"
    for made in (photos, work, work / "borders", work / "features"):
        made.mkdir()
    held_out = tuple(name for name in _names(scene.quality.get("held_out_views")) if name not in withdrawn)
    whole = kept_capture(source, scene.cameras, scene.scale, held_out, work / "borders")
    left = photos_left([view.posed.name for view in whole.views], withdrawn)
    numbers = {posed.name: number for number, posed in enumerate(scene.cameras)}
    times = scene.quality.get(TAKEN_AT) or {}
    views: list[View] = []
    for view in whole.views:
        if view.posed.name in left:
            moved = _moved(view, out, len(views))
            views.append(replace(moved, taken_at=times.get(view.posed.name)))
            if moved.valid_path is not None:
                link_or_copy(moved.valid_path, work / "features" / f"{moved.image_path.name}.png")
    points, colors, error_px = _triangulated(tuple(views), photos, work, settings, progress)
    capture = replace(
        whole,
        views=tuple(views),
        points=points,
        point_colors=colors,
        given_labels=share_labels(source, photos, [numbers[name] for name in left]),
        report=_report(scene.quality, len(views), error_px, withdrawn),
    )
    keep_points(capture, photos)
    shutil.rmtree(work)
    progress(ProgressEvent(_STAGE, 1.0, f"{len(views)} photos, {len(points)} points"))
    return capture


def with_joined_cameras(trained: Scene, current: Scene) -> Scene:
    """The trained version with the cameras of photos that have joined since, and what is known of all photos.

    Args:
        trained: the trained version.
        current: the current one.
    """
    into = frame_of(current).inverse()
    joined = map(into.camera, current.cameras[len(trained.cameras) :])
    return replace(trained, cameras=(*trained.cameras, *joined), quality=current.quality)


def _moved(view: View, out: Path, number: int) -> View:
    """A view whose photo, and its mask, are also those of another folder."""
    image, valid = photo_path(out, number), valid_path(photo_folder(out), number)
    link_or_copy(view.image_path, image)
    if view.valid_path is None:
        return replace(view, image_path=image)
    link_or_copy(view.valid_path, valid)
    return replace(view, image_path=image, valid_path=valid)


def _triangulated(
    views: tuple[View, ...], photos: Path, work: Path, settings: CaptureSettings, progress: Progress
) -> tuple[np.ndarray, np.ndarray, float]:
    """Points float32 [P, 3] on what the views show, their colors uint8 [P, 3], and their mean error in pixels; none
    where these photos alone tell none: training then begins at random places, and says so in the scene's quality."""

    def listen(fraction: float, message: str) -> None:
        progress(ProgressEvent(_STAGE, _TRIANGULATED * min(1.0, fraction), message))

    def run(task: PosedTask, request: dict[str, Any]) -> SfmAnswer:
        (work / task).mkdir()
        request = {**request, "mask_folder": str(work / "features")}
        result = run_sandboxed(task, request, work / task, settings, listen)
        with np.load(work / task / "points.npz") as arrays:
            return result, arrays["points"], arrays["colors"]

    points, colors = no_points()
    few = settings.model_copy(update={"min_points": 0})
    try:
        geometry = posed_geometry(PosedDataset((), points, colors), views, photos, few, run)
    except ReconstructionError:
        return points, colors, 0.0
    return geometry.points, geometry.colors, geometry.error_px


def _report(quality: Mapping[str, Any], views: int, error_px: float, withdrawn: Collection[str]) -> CaptureReport:
    """What the report of the capture said, as far as the scene's quality has it, without the withdrawn photos."""
    scale, vertical = quality.get("scale_source"), quality.get("vertical_source")
    withheld, left_out = quality.get("withheld"), quality.get("left_out")
    return CaptureReport(
        source=quality.get("source", "images"),
        images=int(quality.get("images", views + len(withdrawn))) - len(withdrawn),
        unregistered=_names(quality.get("unregistered")),
        models=(views,),
        mean_reprojection_error_px=error_px,
        warnings=tuple(
            warning for warning in _names(quality.get("warnings")) if not any(name in warning for name in withdrawn)
        ),
        scale=None if scale is None else ScaleEstimate(scale, 1.0, float(quality["scale_error_95"])),
        vertical=None if vertical is None else VerticalEstimate(vertical, float(quality["vertical_deviation_deg"])),
        withheld=None if withheld is None else WithheldReport(**withheld),
        left_out={str(name): str(why) for name, why in left_out.items()} if isinstance(left_out, Mapping) else {},
    )


def _names(values: object) -> tuple[str, ...]:
    return tuple(map(str, values)) if isinstance(values, (list, tuple)) else ()
