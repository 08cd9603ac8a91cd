"""Trains a scene: geometry, color, semantic codes and the affine map W in one run.

Everything is optimized together from the first step: the single phase of the FAST-Splat paper.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from fastsplat.service.capture.captures import Capture
from fastsplat.service.common.progress import Progress, ProgressEvent
from fastsplat.service.perception.results import Labelling
from fastsplat.service.scene.artefact.scene import Evidence, Gaussians, SemanticHead
from fastsplat.service.splatting.exposure.photometric_training import CORRECTIONS, photo_corrections, start_corrections
from fastsplat.service.splatting.exposure.scene_exposure import scene_exposure
from fastsplat.service.splatting.gaussians import color_parameters, final_gaussians
from fastsplat.service.splatting.initial import StartPoints, scene_extent, start_gaussians, start_points
from fastsplat.service.splatting.labels.label_refit import refit_codes
from fastsplat.service.splatting.labels.label_supervision import LabelSupervision
from fastsplat.service.splatting.labels.semantics import ghost_share, start_codes, start_head
from fastsplat.service.splatting.labels.view_evidence import views_evidence
from fastsplat.service.splatting.raster.checks import device_of
from fastsplat.service.splatting.raster.image_formation import Backend
from fastsplat.service.splatting.results import TrainedSplats
from fastsplat.service.splatting.state import SplatState, new_state, restored_state
from fastsplat.service.splatting.torch_runtime import one_torch_thread
from fastsplat.service.splatting.training.checkpoint import (
    Checkpoint,
    fingerprint_of,
    read_checkpoint,
    write_checkpoint,
)
from fastsplat.service.splatting.training.depth_regularization import MAX_ANCHORS, AnchorPoints
from fastsplat.service.splatting.training.optimization import Trainer
from fastsplat.service.splatting.training.previews import UNWATCHED, Previews, TrainingWatch
from fastsplat.service.splatting.training.quality import measure_views, require_likeness
from fastsplat.service.splatting.training.recorder import Recorder
from fastsplat.service.splatting.training.requirement import Requirement
from fastsplat.service.splatting.training.run_watch import return_warnings
from fastsplat.service.splatting.training.schedule import image_scales
from fastsplat.service.splatting.training_settings import FEWEST_STEPS, TrainingSettings
from fastsplat.service.splatting.training_views import TrainingView, capture_split, drop_empty_label_maps, load_views
from fastsplat_contract.errors import InvalidInputError


def splats_under_way(
    parameters: Mapping[str, Tensor], labelling: Labelling, views: Sequence[TrainingView], settings: TrainingSettings
) -> TrainedSplats:
    """Exports current parameters, without a finished run's measurements, refit and pruning.

    Raises:
        TrainingDivergedError: a parameter is not finite.
    """
    gaussians, head = final_gaussians(parameters, settings.cull_opacity)
    quality = {"gaussians": float(len(gaussians)), "sh_degree": float(gaussians.sh_degree)}
    supervision = LabelSupervision(labelling, settings, device_of(settings.backend))
    if supervision.mode == "codes":
        return TrainedSplats(gaussians, head, quality, ())
    evidence = _evidence(gaussians, views, supervision, settings.backend) if supervision.labels else None
    return TrainedSplats(gaussians, SemanticHead.unlearnt(supervision.labels), quality, (), evidence)


def train(
    capture: Capture,
    labelling: Labelling,
    settings: TrainingSettings,
    progress: Progress,
    checkpoint_dir: Path | None = None,
    *,
    watch: TrainingWatch = UNWATCHED,
) -> TrainedSplats:
    """Trains a scene until `settings.iterations`, `settings.time_budget_s` or `watch.finish`, whichever comes first.

    Args:
        capture: views with poses, and points (few or none are made up for by random ones).
        labelling: one label map per view; an empty dictionary trains without semantics (codes of size 0).
        settings: how long, how large and how fine.
        progress: called with metrics loss, psnr (held-out views, or the last training view when none is held out),
            gaussians, iterations_per_second; may raise `CancelledError`, which ends the run at once.
        checkpoint_dir: where the run's state is kept; a checkpoint there is continued, to the bit when the run is
            bounded by iterations alone.
        watch: is shown pictures of the training, and may end it once it has 250 steps; by default nobody.

    Raises:
        InvalidInputError: no views, points that are not finite, images that contradict their cameras.
        ModelUnavailableError: backend cuda without an NVIDIA GPU or gsplat.
        ConflictError: the checkpoint belongs to another run.
        TrainingDivergedError: the loss or a Gaussian became NaN or infinite, or see `require_likeness`.
    """
    if not capture.views:
        raise InvalidInputError("the capture has no registered views", field="capture.views")
    if labelling.label_maps and len(labelling.label_maps) != len(capture.views):
        raise InvalidInputError(
            f"{len(labelling.label_maps)} label maps for {len(capture.views)} views", field="labelling.label_maps"
        )
    device = device_of(settings.backend)  # at once, not after the images have been read
    with one_torch_thread():
        progress(ProgressEvent("training", 0.0, f"loading {len(capture.views)} images"))
        run, views = _load(capture, labelling, settings, device)
        fingerprint = ""
        if checkpoint_dir:
            choices = settings.model_dump(mode="json") | {"exact": labelling.exact}
            labels = [entry.label for entry in labelling.dictionary.entries]
            arrays = capture.points, capture.point_colors
            fingerprint = fingerprint_of(choices, labels, (*views, *run.held_out), arrays)
        checkpoint = read_checkpoint(checkpoint_dir, fingerprint) if checkpoint_dir else None
        if checkpoint:
            state = restored_state(checkpoint.tensors, checkpoint.iteration, device)
        else:
            state = _start(run, views, settings, device)

        def save(state: SplatState, elapsed_s: float) -> None:
            assert checkpoint_dir is not None
            write_checkpoint(Checkpoint(state.iteration, elapsed_s, state.tensors()), checkpoint_dir, fingerprint)

        there = tuple(view.to(device) for view in views)

        # Not of the trainer, which has the recorder: in a ring of references all that is on a GPU would stay there.
        def draft(state: SplatState, share: float) -> None:
            watch.draft(splats_under_way(state.parameters, labelling, there, settings), share)

        recorder = Recorder(
            settings,
            progress,
            run.held_out,
            run.start.random,
            save if checkpoint_dir else None,
            Previews(there[len(there) // 2], settings.backend, watch.show) if watch.show else None,
            draft,
            watch.drafts_at,
        )
        requirement = Requirement(settings, there, run.held_out, state)
        trainer = Trainer(
            state,
            there,
            anchor_points=_anchor_points(capture, settings.seed, device),
            supervision=run.supervision,
            start_points=torch.from_numpy(run.start.points),
            recorder=recorder,
            requirement=requirement,
            settings=settings,
            extent=run.extent,
            elapsed_s=checkpoint.elapsed_s if checkpoint else 0.0,
            finish=watch.finish,
        )
        trainer.run()
        if trainer.state.iteration >= FEWEST_STEPS:
            corrections = trainer.state.parameters.get(CORRECTIONS)
            requirement.finish()
            require_likeness(trainer.state.parameters, there, run.held_out, corrections, settings.backend)
        refit_seconds = _refit_labels(run, trainer, settings)
        trained = _finished(run, trainer, recorder, requirement, settings, refit_seconds)
        recorder.report(trainer.state, trainer.elapsed_s, 1.0)
        return trained


@dataclass(frozen=True)
class _Run:
    """What a run knows of its capture, training views excepted."""

    held_out: tuple[TrainingView, ...]  # on the backend's device
    supervision: LabelSupervision
    start: StartPoints
    extent: float  # of the scene, scene units


def _load(
    capture: Capture, labelling: Labelling, settings: TrainingSettings, device: torch.device
) -> tuple[_Run, tuple[TrainingView, ...]]:
    """The run, and its training views on the CPU."""
    training, held_out = capture_split(capture, settings.held_out_every)
    views = load_views(capture, labelling, training, settings.max_side, image_scales(settings))
    test_views = load_views(capture, labelling, held_out, settings.max_side, (1.0,))
    start = start_points(capture.points, capture.point_colors, views, settings.max_gaussians, settings.seed)
    run = _Run(
        tuple(view.to(device) for view in test_views),
        LabelSupervision(labelling, settings, device),
        start,
        scene_extent(views, start.points),
    )
    return run, drop_empty_label_maps(views)


def _anchor_points(capture: Capture, seed: int, device: torch.device) -> AnchorPoints:
    """Points of the capture, at most `MAX_ANCHORS`; never the random ones that a run may start with."""
    rows = np.arange(len(capture.points))
    if len(rows) > MAX_ANCHORS:
        rows = np.sort(np.random.default_rng((seed, 6)).choice(len(rows), MAX_ANCHORS, replace=False))
    points, colors = capture.points[rows].astype(np.float32), capture.point_colors[rows].astype(np.float32) / 255
    return AnchorPoints(torch.from_numpy(points).to(device), torch.from_numpy(colors).to(device))


def _start(run: _Run, views: tuple[TrainingView, ...], settings: TrainingSettings, device: torch.device) -> SplatState:
    """A new run, on the capture's points."""
    class_codes = run.supervision.class_codes
    weight, bias = start_head(class_codes)
    parameters = start_gaussians(run.start, run.extent, settings.max_sh_degree)
    codes = start_codes(run.start.points, views, class_codes)
    parameters |= {"codes": codes, "weight": weight, "bias": bias}
    return new_state(parameters | start_corrections(views, settings), device)


def _refit_labels(run: _Run, trainer: Trainer, settings: TrainingSettings) -> float:
    """See `TrainingSettings.label_refit_epochs`; returns the seconds it took."""
    begun = time.monotonic()
    supervision = run.supervision
    if supervision.mode != "codes" or not supervision.exact or not settings.label_refit_epochs:
        return 0.0
    refit_codes(
        trainer.state,
        trainer.views,
        supervision.class_codes,
        supervision.class_weights,
        undetected_weight=supervision.undetected_weight,
        epochs=settings.label_refit_epochs,
        seed=settings.seed,
        backend=settings.backend,
    )
    return time.monotonic() - begun


def _finished(
    run: _Run,
    trainer: Trainer,
    recorder: Recorder,
    requirement: Requirement,
    settings: TrainingSettings,
    refit_seconds: float,
) -> TrainedSplats:
    """What the run leaves, and its figures."""
    supervision, backend = run.supervision, settings.backend
    gaussians, head = final_gaussians(trainer.state.parameters, settings.cull_opacity)
    corrections = photo_corrections(trainer.state, trainer.views)
    exposure: dict[str, float] = {}
    if corrections:
        rows = trainer.state.parameters[CORRECTIONS].detach()
        gaussians, exposure["exposure_ev"] = scene_exposure(gaussians, trainer.views, rows, backend)
    quality = {
        "iterations": float(trainer.state.iteration),
        "gaussians": float(len(gaussians)),
        "train_seconds": trainer.elapsed_s,
        "held_out": float(len(run.held_out)),
        "random_points": float(run.start.random),
        "sh_degree": float(gaussians.sh_degree),
        **exposure,
        **requirement.figures(),
    }
    if settings.time_budget_s is not None:
        quality["time_budget_s"] = settings.time_budget_s
    if recorder.preview_seconds:
        quality["preview_seconds"] = recorder.preview_seconds
    if trainer.progress < 1:
        quality["stopped_at_share"] = trainer.progress
    if recorder.loss is not None:
        quality["loss"] = recorder.loss
    evidence = None
    if supervision.mode == "evidence":
        begun = time.monotonic()
        evidence = _evidence(gaussians, trainer.views, supervision, backend)
        quality["evidence_seconds"] = time.monotonic() - begun
    elif supervision.labels:
        quality["label_refit_seconds"] = refit_seconds
        quality["ghost_share"] = ghost_share(gaussians.codes, gaussians.logit_opacities, head)
    quality |= measure_views(color_parameters(gaussians, device_of(backend)), run.held_out, backend)
    held_out = tuple(view.name for view in run.held_out)
    warnings = return_warnings(trainer.state)
    return TrainedSplats(gaussians, head, quality, held_out, evidence, corrections, warnings)


def _evidence(
    gaussians: Gaussians, views: Sequence[TrainingView], supervision: LabelSupervision, backend: Backend
) -> Evidence:
    classes, undetected = supervision.labels + 1, supervision.undetected_weight
    return views_evidence(gaussians, views, classes, undetected_weight=undetected, backend=backend)
