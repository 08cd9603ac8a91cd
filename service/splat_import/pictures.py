"""Builds the capture of a splat without photos by rendering pictures around it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image

from fastsplat.service.capture.captures import Capture, CaptureReport, View
from fastsplat.service.capture.formats.capture_files import load_capture, save_capture
from fastsplat.service.capture.formats.image_io import save_rgb
from fastsplat.service.capture.formats.upload_manifest import read_manifest
from fastsplat.service.capture.uploads.splat_input import take_splat
from fastsplat.service.common.files import atomic_directory
from fastsplat.service.common.progress import Progress, ProgressEvent
from fastsplat.service.scene.artefact.scene import Gaussians
from fastsplat.service.splat_import.bulk import find_bulk, uncoded_gaussians
from fastsplat.service.splat_import.splat_import_settings import SplatImportSettings
from fastsplat.service.splat_import.viewpoints import axis_vector, choose_viewpoints, estimate_up, trial_camera
from fastsplat.service.splatting.gaussians import splats_of
from fastsplat.service.splatting.raster.checks import device_of
from fastsplat.service.splatting.raster.image_formation import Backend
from fastsplat.service.splatting.raster.rendering import rasterize, sh_to_rgb
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.jobs.operations import UpAxis

_FIELD_OF_VIEW_DEG = 60.0  # horizontal

_STAGE = "capture"
_SEARCH = 0.6  # share of the progress
_COVERED = 0.5  # alpha from which on a pixel has content


@torch.no_grad()
def render_views(
    validated_dir: Path,
    out_dir: Path,  # new or empty; appears only when complete
    settings: SplatImportSettings,
    progress: Progress,  # of the stage "capture"; may raise CancelledError
    *,
    up: UpAxis | None = None,  # in the splat's world; None: estimated
    backend: Backend = "cpu",
) -> Capture:
    """Renders the capture of a validated splat without photos, in its own world.

    Raises:
        InvalidInputError: nothing of the splat can be seen.
    """
    manifest, files = read_manifest(validated_dir)
    with atomic_directory(out_dir) as partial:
        splat = take_splat(files.parent, partial)
        gaussians = uncoded_gaussians(splat)
        bulk = find_bulk(gaussians)
        upward = axis_vector(up) if up is not None else estimate_up(gaussians, bulk)

        def on_trial(done: int, total: int) -> None:
            progress(ProgressEvent(_STAGE, _SEARCH * done / total, f"looking for viewpoints {done}/{total}"))

        poses = choose_viewpoints(
            gaussians, bulk, upward, settings.pictures, _FIELD_OF_VIEW_DEG, on_trial, backend=backend
        )
        camera = trial_camera(_FIELD_OF_VIEW_DEG, settings.picture_side)
        cameras = [PosedCamera(camera, pose, f"picture-{number:03d}.png") for number, pose in enumerate(poses)]

        def on_picture(done: int) -> None:
            fraction = _SEARCH + (1 - _SEARCH) * done / len(poses)
            progress(ProgressEvent(_STAGE, fraction, f"pictures {done}/{len(poses)}"))

        views = render_pictures(Painter(gaussians, backend).picture, cameras, partial, on_picture)
        report = CaptureReport(
            source="splat",
            images=len(views),
            models=(len(views),),
            warnings=(*manifest.warnings, *(() if up is not None else (_up_warning(upward),))),
            splat=manifest.splat,
        )
        points, colors = np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8)
        save_capture(Capture(views, points, colors, "ARBITRARY", report, splat=splat), partial)
    progress(ProgressEvent(_STAGE, 1.0, f"{len(poses)} pictures around {len(gaussians)} Gaussians"))
    return load_capture(out_dir)


Paint = Callable[[PosedCamera], tuple[NDArray[np.uint8], NDArray[np.bool_]]]
"""Renders the picture of a camera as `Painter.picture` does."""


class Painter:
    """Renders Gaussians on black; holds their tensors between pictures."""

    def __init__(self, gaussians: Gaussians, backend: Backend = "cpu") -> None:
        self._backend: Backend = backend
        self._splats = splats_of(gaussians, device=device_of(backend))
        self._sh = torch.tensor(gaussians.sh, device=self._splats.means.device)
        self._degree = gaussians.sh_degree

    @torch.no_grad()
    def picture(self, posed: PosedCamera) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
        """Renders uint8 [H, W, 3] and the mask of pixels with content, bool [H, W]."""
        pose, means = posed.world_from_camera, self._splats.means
        position = torch.from_numpy(pose[:3, 3].astype(np.float32)).to(means.device)
        viewmat = torch.from_numpy(np.linalg.inv(pose).astype(np.float32)).to(means.device)
        colors = sh_to_rgb(means, self._sh, position, self._degree, backend=self._backend)
        rendering = rasterize(replace(self._splats, features=colors), viewmat, posed.camera, backend=self._backend)
        pixels = (rendering.image.clamp(0, 1) * 255).round().to(torch.uint8).cpu().numpy()
        return pixels, rendering.alpha.cpu().numpy() >= _COVERED


def render_pictures(
    paint: Paint, cameras: Sequence[PosedCamera], folder: Path, on_picture: Callable[[int], None] = lambda done: None
) -> tuple[View, ...]:
    """Writes pictures and masks of their content as views, in new folders below `folder`.

    Calls `on_picture` before each with the number done; it may raise `CancelledError`.
    """
    (folder / "images").mkdir()
    (folder / "masks").mkdir()
    views = []
    for index, posed in enumerate(cameras):
        on_picture(index)
        pixels, covered = paint(posed)
        image_path, valid_path = folder / "images" / f"{index:05d}.png", None
        save_rgb(pixels, image_path)
        if not covered.all():
            valid_path = folder / "masks" / f"{index:05d}.png"
            Image.fromarray(covered.astype(np.uint8) * 255).save(valid_path)
        views.append(View(posed, image_path, valid_path))
    return tuple(views)


def _up_warning(up: NDArray[np.float64]) -> str:
    numbers = ", ".join(f"{value:.2f}" for value in up)
    return (
        f"Up is not known in a splat; it was estimated as ({numbers}). If the pictures of the views are tilted or "
        'upside down, post it again with "up", e.g. "-y".'
    )
