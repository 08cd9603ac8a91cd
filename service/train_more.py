"""A finished scene trained further: with the photos that are kept with it, or that join them, from where it is, as a
new version.

Things, their ids, names and parts, labels and their evidence stay with the Gaussians that come from those which had
them. What people did meanwhile that changes no Gaussian is in the new version, too.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.capture.formats.image_io import load_rgb
from fastsplat.service.capture.formats.kept_capture import kept_capture
from fastsplat.service.capture.photos.scene_photos import photo_folder
from fastsplat.service.capture.types import Capture
from fastsplat.service.common.progress import Progress
from fastsplat.service.localization.agreed_places import agreed_places
from fastsplat.service.planning.presets import PresetName, apply_preset
from fastsplat.service.query.edits.aligning import placed_gaussians
from fastsplat.service.scene.frames import frame_of
from fastsplat.service.scene.label_evidence import rows_of
from fastsplat.service.scene.things import things_of_rows
from fastsplat.service.scene.types import Gaussians, Scene
from fastsplat.service.settings import Settings
from fastsplat.service.splatting.continuation import Continued, continuation_settings, continue_training
from fastsplat.service.splatting.joining import join_photos
from fastsplat.service.splatting.previews import UNWATCHED, TrainingWatch
from fastsplat_contract.errors import NotReadyError, TrainingDivergedError

_STEPS_FOR_A_PHOTO = 100
"""Of one that joins, half of them with the photos of before."""
_JOINING_MAY_COST_DB = 0.1
"""Photos that training does not see need not show anything of what has joined."""
_SAME = 1e-4
"""Share of a scene's extent by which rounding may move a Gaussian."""


def capture_of(scene: Scene, folder: Path, scratch: Path) -> Capture:
    """The capture that is kept with a version of a scene, in this version's frame.

    Args:
        scene: the version.
        folder: of the version.
        scratch: an existing folder for masks.

    Raises:
        NotReadyError: no photo is kept with it.
        SceneFileError: a file is damaged.
    """
    held_out = scene.quality.get("held_out_views")
    names = tuple(str(name) for name in held_out) if isinstance(held_out, (list, tuple)) else ()
    capture = kept_capture(photo_folder(folder), scene.cameras, scene.scale, names, scratch)
    if not capture.views:
        raise NotReadyError("no photos are kept with this scene", field="scene", hint="Post the photos again.")
    points = frame_of(scene).points(capture.points).astype(np.float32)
    return replace(capture, points=points)


def train_further(
    scene: Scene,
    capture: Capture,
    settings: Settings,
    progress: Progress,
    checkpoint_dir: Path | None = None,
    *,
    joined: Collection[str] = (),
    seconds: float | None = None,
    steps: int | None = None,
    preset: PresetName | None = None,
    watch: TrainingWatch = UNWATCHED,
) -> Continued:
    """The Gaussians of a scene after more training.

    Args:
        scene: the version to go on from.
        capture: see `capture_of`.
        settings: of all rooms.
        progress: hears of the stage "training"; may raise `CancelledError`.
        checkpoint_dir, watch: as for `train`.
        joined: names of views of the capture that the scene has not seen, and that are to join it: then only what they
            show is trained, see `join_photos`; with none all is, on all views.
        seconds, steps, preset: how long, and how large; see `TrainMoreIn`.

    Raises:
        TrainingDivergedError: it ended worse than it began, by photos that it did not see.
        FastSplatError: as `train`.
    """
    if joined and seconds is None and steps is None:
        steps = _STEPS_FOR_A_PHOTO * len(joined)
    training = continuation_settings(
        apply_preset(settings, preset).training,
        scene.gaussians,
        seconds=seconds,
        steps=steps,
        hold_out=bool(capture.test_names),
    )
    if joined:
        places = agreed_places(
            [(view.posed, load_rgb(view.image_path)) for view in capture.views if view.posed.name in joined]
        )
        continued = join_photos(
            scene.gaussians, capture, joined, training, progress, checkpoint_dir, places=places, watch=watch
        )
    else:
        continued = continue_training(scene.gaussians, capture, training, progress, checkpoint_dir, watch=watch)
    name = "psnr_cc" if continued.trained.photometric else "psnr"  # a corrected scene has the photos' mean exposure
    before, after = (continued.trained.quality.get(figure) for figure in (f"{name}_before", name))
    if before is not None and after is not None and after < before - (_JOINING_MAY_COST_DB if joined else 0.0):
        raise TrainingDivergedError(
            f"photos that training does not see are reproduced with {after:.2f} dB in place of {before:.2f} dB, so the "
            "scene stays as it is",
            field="scene",
            hint="Train for more steps, with a larger preset; or the photos do not give more.",
        )
    return continued


def merged_scene(current: Scene, base: Scene, continued: Continued) -> Scene | None:
    """The current version of a scene with the Gaussians of one that was trained further.

    Args:
        current: the version as it is now; its names, things, scale and frame are those of the result.
        base: the version that was trained further.
        continued: what came of it, in the frame of `base`.

    Returns:
        None where the two versions do not show the same: then the training contradicts the edits between them.
    """
    change = frame_of(current).after(frame_of(base).inverse())
    if not _shows_the_same(placed_gaussians(base.gaussians, change), current.gaussians):
        return None
    rows = continued.origins
    placed = placed_gaussians(continued.trained.gaussians, change)
    if continued.changed is not None:
        placed = _changed_alone(current.gaussians, placed, continued.changed)
    return replace(
        current,
        gaussians=replace(placed, codes=np.ascontiguousarray(current.gaussians.codes[rows])),
        evidence=None if current.evidence is None else rows_of(current.evidence, rows),
        things=things_of_rows(current.things, rows),
        quality=_quality(current.quality, base, continued),
    )


def _changed_alone(before: Gaussians, after: Gaussians, changed: NDArray[np.bool_]) -> Gaussians:
    """Gaussians of which those that are not `changed` are, to the bit, those of the same rows before."""
    same = np.flatnonzero(~changed)
    arrays = {name: array.copy() for name, array in vars(after).items() if name != "codes"}
    for name, array in arrays.items():
        array[same] = getattr(before, name)[same]
    return replace(after, **arrays)


def _shows_the_same(first: Gaussians, second: Gaussians) -> bool:
    if len(first) != len(second) or first.sh.shape != second.sh.shape:
        return False
    extent = float(np.ptp(second.means, axis=0).max()) if len(second) else 0.0
    near = np.abs(first.means.astype(np.float64) - second.means) <= _SAME * extent
    return bool(near.all()) and bool(np.allclose(first.sh[:, 0], second.sh[:, 0], atol=1e-4))


def _quality(before: Any, base: Scene, continued: Continued) -> dict[str, Any]:
    """The figures of the new version: those of before, with what was measured anew, steps and seconds of both."""
    figures = dict(continued.trained.quality)
    figures.pop("random_points", None)
    summed = {}
    for name in ("iterations", "train_seconds"):
        earlier = base.quality.get(name)
        summed[name] = figures[name] + (float(earlier) if isinstance(earlier, (int, float)) else 0.0)
    both = (base.quality.get("time_budget_s"), figures.pop("time_budget_s", None))
    bounds = [float(bound) for bound in both if isinstance(bound, (int, float))]
    quality = {name: value for name, value in dict(before).items() if name not in ("time_budget_s", "stopped_at_share")}
    if len(bounds) == len(both):
        summed["time_budget_s"] = sum(bounds)
    rounds = base.quality.get("trained_further")
    return {
        **quality,
        **figures,
        **summed,
        "stopped_early": "stopped_at_share" in figures,
        "gaussians": len(continued.trained.gaussians),
        "trained_further": (rounds if isinstance(rounds, int) else 0) + 1,
    }
